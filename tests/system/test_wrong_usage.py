"""Wrong verbs, options, numbers and their combinations: what the command line alone shows."""

import pytest
from wrong_inputs import Row, file, ids, session, stdin

PROBE = "commission --yes-read-only"
DRAFT = ("rig-profile.toml", "rig-profile.results.json")
ROWS = [
    Row("no such verb", "bogus", 2, ("no command 'bogus'",), "known: annotate, benchmark, commission"),
    Row("nearly a verb", "rum", 2, ("no command 'rum'",), "did you mean run?"),
    Row("a verb of other programs", "simulate", 2, ("no command 'simulate'",), "did you mean run --virtual?"),
    Row("a verb that only sounds alike", "golden plot", 2, ("no command 'plot'",), "known: add"),
    Row("a gain as an option", "run --Mk 5", 2, ("No such option '--Mk'",), "--set controller.gains.Mk=VALUE"),
    Row("underscore for a dash", "what_if", 2, ("what_if",), "did you mean what-if?"),
    Row("nearly a verb of a group", "golden tset", 2, ("no command 'tset'",), "did you mean test?"),
    Row("nearly an option", "run --bord sim:", 2, ("--bord",), "--board"),
    Row("an argument too many", "run extra", 2, ("extra",), "inteco-abs run --help"),
    Row("an argument too few", "replay", 2, ("Missing argument 'FILE'",), "inteco-abs replay --help"),
    Row("one of two files", "diff a.mcap", 2, ("Missing argument 'B'",), "inteco-abs diff --help"),
    Row("a required option", "golden add a.mcap", 2, ("Missing option '--reason'",), "inteco-abs golden add --help"),
    Row("no such choice", "run --live often", 2, ("'often'",), "'full', 'line', 'none'"),
    Row("no such format", "export a.mcap --format xls", 2, ("'xls'",), "'csv', 'npz', 'mat', 'parquet'"),
    Row("a folder without a name", "sweep --store ''", 2, ("--store", "''"), "must name a file or folder"),
    Row("a model without a name", "fmu ''", 2, ("OUT", "''"), "must name a file or folder"),
    Row("no such file of a model", "fmu rig.zip", 2, ("OUT: rig.zip",), "must end in .fmu"),
    Row("no such width", "figure a.mcap -o x.png --width 3", 2, ("'3'",), "'one', 'two'"),
    Row("no such shell", "completion tcsh", 2, ("'tcsh'",), "'bash', 'zsh', 'fish'"),
    Row("no such viewer", "viewer-layout --for rviz", 2, ("'rviz'",), "'lichtblick', 'plotjuggler'"),
    Row("no such protocol", "wire import a.pcap -o b.jsonl --protocol usb3", 2, ("--protocol: no protocol 'usb3'",),
        "did you mean usb2?"),
    Row("no such section", "diff a.mcap b.mcap --only gain", 2, ("no section 'gain'",), "did you mean gains?"),
    Row("no such column", "list --sort slip", 2, ("--sort: no column 'slip'",), "known: band_entry_s"),
    Row("no such key to explain", "config explain brake_limt", 2, ("brake_limt",), "did you mean guard.brake_limit?"),
    Row("no such profile", "profiles usb3", 2, ("'usb3'",), "usb2"),
    Row("no such step", "commission --step moters", 2, ("no step 'moters', 1..7",), "did you mean motors?"),
    Row("a word for a whole number", "run --seed one", 2, ("--seed", "'one'"), "a whole number of at least 0"),
    Row("a negative seed", "run --seed -1", 2, ("--seed", "-1"), "a whole number of at least 0"),
    Row("a fraction of a seed", "run --seed 1.5", 2, ("--seed", "'1.5'"), "a whole number of at least 0"),
    Row("another's option", "repeat 2 --record-wire y", 2, ("--record-wire",), "inteco-abs repeat --help"),
    Row("a series with no such controller", "repeat 2 --virtual --controller quantum", 2, ("'quantum'",), "known: "),
    Row("a serial number for no rules", "doctor --ftdi-serial A1", 2, ("--ftdi-serial",), "only with --rules"),
    Row("a serial number that is empty", "doctor --rules --ftdi-serial ''", 2, ("--ftdi-serial: ''",),
        "1 to 32 letters"),
    Row("a duration too short", "doctor --seconds 0.1", 2, ("--seconds: 0.1",), "0.2..60 s"),
    Row("none of a series", "repeat 0", 2, ("'N'", "'0'"), "a whole number in 1..1000"),
    Row("too many of a series", "repeat 5000", 2, ("'5000'",), "a whole number in 1..1000"),
    Row("a decimal comma", "repeat 2 --pause 1,5", 2, ("--pause", "'1,5'", "0..3600 s"), "write 1.5"),
    Row("a comma between thousands", "repeat 2 --pause 1,800", 2, ("'1,800'", "0..3600 s"), "write 1.800 or 1800"),
    Row("a unit behind a number", "repeat 2 --pause 30s", 2, ("'30s'",), "write the number alone"),
    Row("another unit", "repeat 2 --pause 500ms", 2, ("'500ms'",), "write the number alone in s: 0.5"),
    Row("not a number", "repeat 2 --pause nan", 2, ("'nan'",), "a number in 0..3600 s"),
    Row("infinite", "repeat 2 --pause inf", 2, ("'inf'",), "a number in 0..3600 s"),
    Row("nothing for a number", "repeat 2 --pause ''", 2, ("''",), "a number in 0..3600 s"),
    Row("a duration beyond reason", "doctor --seconds 1e9", 2, ("--seconds", "1e+09"), "0.2..60 s"),
    Row("no duration at all", "doctor --seconds nan", 2, ("--seconds", "'nan'"), "a number, in s"),
    Row("a rate that is not a number", "mock-board --pty --truth-hz nan", 2, ("'nan'",), "a number in 0.1..1000 Hz"),
    Row("a blink too long", "identify-led --seconds 100", 2, ("'100'",), "a number in 0.1..60 s"),
    Row("a port beyond all", "run --foxglove 70000", 2, ("'70000'",), "a whole number in 0..65535"),
    Row("speeds the wrong way", "design --speeds 100 50", 2, ("100 50: must rise",), "write --speeds 50 100"),
    Row("speeds with a comma", "design --speeds 10 99,5", 2, ("'99,5'",), "write 99.5"),
    Row("rigs in a range reversed", "sweep --rigs hard:9-0", 2, ("the range is reversed",), "write hard:0-9"),
    Row("nearly a population", "sweep --rigs hrd:0-9", 2, ("no population 'hrd'",), "did you mean hard?"),
    Row("nearly a population for one", "run --rig hrd:17", 2, ("'hrd:17'", "simulation.rig"), "did you mean hard?"),
    Row("a part beyond the last", "sweep --work x --part 3/2", 2, ("'3/2'",), "must look like 3/10"),
    Row("a part of nothing", "sweep --work x --part 1", 2, ("'1'",), "the third of ten parts"),
    Row("no jobs", "sweep --jobs 0", 2, ("'0'",), "a whole number in 1..1024"),
    Row("no values to sweep", "sweep --set nonsense", 2, ("--set nonsense",), "must look like controller.gains.Mk=2"),
    Row("a setting without equals", "run --set guard.brake_limit", 2, ("has no =",), "look like guard.brake_limit=0.7"),
    Row("a setting in two words", "run --set guard.brake_limit 0.7", 2, ("has no =",), "guard.brake_limit=0.7"),
    Row("virtual time on a real board", "run --board usb2:7 --virtual", 2, ("usb2:7", "real board"), "omit --virtual"),
    Row("a drawn rig on a real board", "run --rig hard:1 --board usb2:", 2, ("--rig", "usb2:"), "sim: only"),
    Row("a viewer of virtual time", "run --virtual --foxglove", 2, ("--foxglove",), "omit one of the two"),
    Row("a mock board nowhere", "mock-board", 2, ("--usbip, --pty",), "name one of them"),
    Row("a mock board twice", "mock-board --usbip --pty", 2, ("--usbip, --pty",), "name one of them"),
    Row("a mock board on PCI", "mock-board --board pci --pty", 2, ("pci",), "run --board sim: --set profile=sim_pci"),
    Row("a USB board at a serial port", "mock-board --board usb2 --pty", 2, ("usb2",), "use --pty with --board usb"),
    Row("a mock with a short serial", "mock-board --usbip --serial 12", 2, ("12",), "900000000..999999999"),
    Row("a mock with another kind's profile", "mock-board --usbip --board usb --config usb2.toml", 2,
        ("board.kind: 'usb2'", "'usb'"), "name another profile", (file("usb2.toml", 'profile = "sim_usb2"\n'),)),
    Row("a mock with no such rig", "mock-board --pty --rig slw:1", 2, ("simulation.rig",), "did you mean slow?"),
    Row("a mock at no port", "mock-board --usbip ':x'", 2, ("'x' is not a port",), "must be 0..65535"),
    Row("an LED that is not there", "identify-led --board sim:", 2, ("'sim:'", "only an RT-DAC/USB2"),
        "as in usb2:123"),
    Row("no such fault", "run --virtual --inject bogus@1s", 2, ("no fault 'bogus'",), "known: alarm"),
    Row("a fault without its unit", "run --virtual --inject lose@20", 2, ("'20' is not a time",), "write 500us, 20ms"),
    Row("a fault of a real board", "run --board usb2: --inject lose@20ms", 2, ("--inject", "usb2:"), "sim: only"),
    Row("nothing to identify", "identify", 2, ("SESSION",), "name at least one session, or --plan"),
    Row("an assumption without unit", "identify a.mcap --assume J1=5", 2, ("J1=5",), "must look like J1=5%"),
    Row("no question", "what-if stop.mcap", 2, ("nothing to compare",), "as controller.gains.Mk=5", (session(),)),
    Row("an endless question", "what-if a.mcap --sweep Mk", 2, ("--sweep Mk",), "like controller.gains.Mk=1,2,5"),
    Row("a question at no time", "what-if a.mcap --set x=1 --at 2s", 2, ("'2s'",), "write the number alone"),
    Row("a tolerance of nothing", "replay stop.mcap --tol slip", 2, ("--tol slip",), "FIELD=ABS", (session(),)),
    Row("a step beyond the last", "commission --redo 9", 2, ("no step '9'",), "1..7"),
    Row("a step before its turn", f"{PROBE} --step 6", 2, ("motors comes after list",), "which is open", leaves=DRAFT),
    Row("no such profile to begin with", f"{PROBE} --profile usb2_generic", 2, ("'usb2_generic'",),
        "did you mean usb2_generic_0103?"),
    Row("a profile of another board", f"{PROBE} --board usb2: --profile usb1_0111", 2, ("board.kind: 'usb'",),
        "name another profile", leaves=DRAFT),
    Row("a draft with one encoder", f"{PROBE} --set simulation.road_encoder=1", 2, ("simulation.wheel_encoder",),
        "another encoder than"),
    Row("a draft's setting without equals", f"{PROBE} --set board.drive_pwm", 2, ("has no =",), "must look like"),
    Row("virtual time at a real bench", f"{PROBE} --board usb2: --virtual", 2, ("real board",), "omit --virtual"),
    Row("steps of two minds", "commission --step 1 --redo 2", 2, ("--redo",), "name one of them"),
    Row(
        "questions without answers",
        "commission", 2, ("cannot answer",), "--yes-read-only: missing", (stdin("/dev/null"),),
    ),
    Row(
        "questions to a closed stdin",
        "commission", 2, ("cannot answer",), "--yes-read-only: missing", (stdin(None),),
    ),
    Row(
        "a panel without a terminal",
        "panel", 1, ("needs a terminal", "nothing was started"), "run it in one", (stdin("/dev/null"),),
    ),
    Row(
        "motors without a terminal",
        "panel --outputs", 1, ("needs a terminal", "nothing was started"), "run it in one", (stdin(None),),
    ),
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=ids(ROWS))
def test_wrong_usage_gets_one_clear_answer(answers, row):
    answers.to(row)


@pytest.mark.untraced
@pytest.mark.parametrize("name", ["nearly a verb", "a decimal comma", "questions without answers"])
def test_the_installed_command_answers_and_ends_the_same_way(inteco_abs, answers, name):
    (row,) = (row for row in ROWS if row.name == name)
    run, here = inteco_abs(*row.command.split()), answers.to(row)
    assert (run.returncode, run.stdout, run.stderr) == (here.returncode, here.stdout, here.stderr)
