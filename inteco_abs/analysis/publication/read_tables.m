% Reads every run beside this file with GNU Octave: octave read_tables.m
folder = fullfile (fileparts (mfilename ("fullpath")), "tables");
files = glob (fullfile (folder, "*-metadata.json"));
for k = 1:numel (files)
  table = jsondecode (fileread (files{k}));
  table = table.tables;
  if iscell (table), table = table{1}; else, table = table(1); end
  file = fopen (fullfile (folder, table.url));
  names = strsplit (fgetl (file), ",");
  ticks = textscan (file, repmat ("%f", 1, numel (names)), "Delimiter", ",");
  fclose (file);
  ticks = cell2mat (ticks);
  braking = ticks(ticks(:, strcmp (strtrim (names), "phase")) == 4, :);
  slip = braking(:, strcmp (strtrim (names), "slip"));
  printf ("%s: %d ticks, %d of them braking\n", table.url, rows (ticks), rows (braking));
  printf ("mean slip %.6f\n", mean (slip));
end
