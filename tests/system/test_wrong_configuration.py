"""Wrong files and wrong keys: what rig.toml and --set can be like that no rig is run with."""

import pytest
from wrong_inputs import Row, file, folder, ids

FILE = "run --virtual --config rig.toml"
SET = "run --virtual --set"


def rig(content):
    return (file("rig.toml", content),)


ROWS = [
    Row("no file", FILE, 2, ("rig.toml", "No such file"), "inteco-abs config init rig.toml writes one"),
    Row("a folder", FILE, 2, ("rig.toml", "is a folder"), "name a file", (folder("rig.toml"),)),
    Row("no regular file", "run --config /dev/null", 2, ("/dev/null",), "not a regular file; name one"),
    Row("nearly its name", "run --config rig.tml", 2, ("rig.tml", "No such file"), "did you mean rig.toml?", rig("")),
    Row("empty", FILE, 2, ("rig.toml: is empty",), "begin one with inteco-abs config init", rig(" \n")),
    Row("far too large", FILE, 2, ("larger than 1000000 bytes",), "is it a configuration?", rig("#" * 1_000_001)),
    Row("not UTF-8", FILE, 2, ("byte 8 is 0xFC",), "save it as UTF-8", rig(b"# Zustan\xfc\n")),
    Row("UTF-16", FILE, 2, ("byte 0 is 0xFF",), "save it as UTF-8", rig("[guard]\n".encode("utf-16"))),
    Row("a mistake after a byte-order mark", FILE, 2, ("rig.toml, line 2", "brake_limt"), "did you mean brake_limit?",
        rig(b"\xef\xbb\xbf[guard]\nbrake_limt = 0.7\n")),
    Row("no file of such a name", "run --config nothere.toml", 2, ("No such file",), "config init", rig("")),
    Row("a file that sounds alike", "run --config missing.toml", 2, ("No such file",), "config init",
        (file("raising.toml"),)),
    Row("a zero byte", FILE, 2, ("byte 8 is zero",), "is it a configuration?", rig(b"[guard]\n\0")),
    Row("a program", "run --config law.py", 2, ("law.py: is not TOML",), "line 1", (file("law.py", "import os\n"),)),
    Row("a colon for an equals sign", FILE, 2, ("Expected '='", "line 2"), "'brake_limit: 0.7'",
        rig("[guard]\nbrake_limit: 0.7\n")),
    Row("a decimal comma", FILE, 2, ("line 2", "'brake_limit = 0,7'"), "write 0.7",
        rig("[guard]\nbrake_limit = 0,7\n")),
    Row("a unit", FILE, 2, ("line 2", "1800rpm"), "write the number alone",
        rig("[experiment]\nstart_speed_rad_s = 1800rpm\n")),
    Row("text without quotes", FILE, 2, ("line 2",), 'text stands between quotes: "relay"',
        rig("[controller]\nname = relay\n")),
    Row("a section that is not closed", FILE, 2, ("line 1", "'[guard'"), "Expected ']'", rig("[guard\n")),
    Row("a YAML tag", FILE, 2, ("line 1", "!!python"), "Invalid value", rig("x = !!python/object:os.system\n")),
    Row("a key twice", FILE, 2, ("line 3", "'hold_s = 2'"), "line 2 has it already: 'hold_s = 1'",
        rig("[experiment]\nhold_s = 1\nhold_s = 2\n")),
    Row("a section twice", FILE, 2, ("line 3", "'[guard]'"), "line 1 has it already",
        rig("[guard]\nbrake_limit = 0.7\n[guard]\n")),
    Row("nested without end", FILE, 2, ("is not TOML",), "nested too deeply", rig("x = " + "[" * 100_000)),
    Row("nearly a key", FILE, 2, ("guard.brake_limt (rig.toml, line 2): unknown key",), "did you mean brake_limit?",
        rig("[guard]\nbrake_limt = 0.7\n")),
    Row("nearly a section", f"{SET} gaurd.brake_limit=0.7", 2, ("gaurd: unknown key",), "did you mean guard?"),
    Row("a gain without its section", f"{SET} Mk=5", 2, ("Mk: unknown key",), "did you mean controller.gains.Mk?"),
    Row("a key without its section", f"{SET} brake_limit=0.7", 2, ("unknown key",), "mean guard.brake_limit?"),
    Row("a key of another program", f"{SET} loop.priority=9", 2, ("loop.priority",), "known: compiled, pace, rate_hz"),
    Row("a version that there is not", FILE, 2, ("format (rig.toml, line 1): unknown key",), "known: board, controller",
        rig("format = 2\n")),
    Row("an include", FILE, 2, ("include (rig.toml, line 1): unknown key",), "known: board",
        rig('include = "../other.toml"\n')),
    Row("a value for a section", FILE, 2, ("guard (rig.toml, line 1): 5",), "must be a section, as [guard]",
        rig("guard = 5\n")),
    Row("a section for a value", f"{SET} guard.brake_limit.x=1", 2, ("guard.brake_limit",), "a number above 0"),
    Row("a number in quotes", FILE, 2, ("experiment.start_speed_rad_s (rig.toml, line 2): '180'", "10"),
        "write it without quotes", rig('[experiment]\nstart_speed_rad_s = "180"\n')),
    Row("a truth for a number", f"{SET} experiment.hold_s=true", 2, ("true",), "a number at least 0 and at most 10"),
    Row("a list for a number", f"{SET} experiment.hold_s=[1]", 2, ("[1]",), "a number at least 0 and at most 10"),
    Row("a date for a number", f"{SET} experiment.hold_s=2026-01-01", 2, ("2026-01-01:",), "a number at least 0"),
    Row("a number for text", f"{SET} controller.name=5", 2, ("controller.name: 5",), "must be text"),
    Row("a fraction for a count", f"{SET} encoders.counts_per_turn=2048.5", 2, ("2048.5",), "a whole number"),
    Row("not a number", f"{SET} experiment.start_speed_rad_s=nan", 2, ("nan",), "at least 10 and at most 240"),
    Row("infinite", f"{SET} experiment.start_speed_rad_s=-inf", 2, ("-inf",), "at least 10 and at most 240"),
    Row("beyond all numbers", f"{SET} experiment.start_speed_rad_s=1e400", 2, ("inf",), "at least 10 and at most 240"),
    Row("400 digits", f"{SET} experiment.start_speed_rad_s={'9' * 400}", 2, ("99999...",), "and at most 240"),
    Row("400 digits of a gain", f"{SET} controller.gains.Mk={'9' * 400}", 2, ("controller.gains.Mk: 999",),
        "must be a number in 0..1000 1/s"),
    Row("400 digits of a count", f"{SET} encoders.counts_per_turn={'9' * 400}", 2, ("9...",), "at most 1000000"),
    Row("5000 digits", f"{SET} guard.brake_limit={'9' * 5000}", 2, ("guard.brake_limit",), "absurdly many digits"),
    Row("a comma in a setting", f"{SET} guard.brake_limit=0,7", 2, ("'0,7'", "at most 1"), "write 0.7"),
    Row("rpm in a setting", f"{SET} experiment.start_speed_rad_s=1800rpm", 2, ("'1800rpm'",), "alone in rad/s: 188.5"),
    Row("ms in a setting", f"{SET} estimator.window_s='10 ms'", 2, ("'10 ms'",), "alone in s: 0.01"),
    Row("per cent in a setting", f"{SET} guard.brake_limit=70%", 2, ("'70%'",), "write the number alone: 0.7"),
    Row("a speed that looks like rpm", f"{SET} experiment.start_speed_rad_s=1800", 2, ("1800", "at most 240"),
        "looks like rpm: 1800 rpm is 188.5 rad/s"),
    Row("a time that looks like ms", f"{SET} estimator.window_s=10", 2, ("10", "at most 0.5"),
        "looks like ms: 10 ms is 0.01 s"),
    Row("a share that looks like per cent", f"{SET} guard.brake_limit=70", 2, ("70", "at most 1"),
        "looks like %: 70 % is 0.7"),
    Row("a rate that looks like kHz", f"{SET} loop.rate_hz=2", 2, ("2", "at least 50"),
        "looks like kHz: that is 2000 Hz"),
    Row("a rate that looks like a period", f"{SET} loop.rate_hz=0.0005", 2, ("0.0005",), "that is 2000 Hz"),
    Row("above the ceiling", f"{SET} guard.over_speed_rad_s=250", 2, ("250", "at most 245"),
        "no configuration can raise"),
    Row("above a real board's ceiling", "run --board usb2: --set guard.missed_in_a_row=60", 2,
        ("guard.missed_in_a_row", "60", "on a real board at most 50 at 2000 Hz"), "25 ms"),
    Row("more than an unsigned profile allows", "run --board usb: --set guard.silence_s=0.08", 2,
        ("guard.silence_s", "at most 0.05", "0.08"), "sign one with inteco-abs commission"),
    Row("a gain out of range", f"{SET} controller.gains.Mk=-1", 2, ("controller.gains.Mk", "-1"), "0..1000 1/s"),
    Row("no such gain", f"{SET} controller.gains.Mx=1", 2, ("controller.gains.Mx", "unknown gain"), "Mk"),
    Row("braking above the limit", f"{SET} guard.over_speed_rad_s=100", 2, ("experiment.start_speed_rad_s", "180"),
        "must be at most 0.9 times guard.over_speed_rad_s = 100"),
    Row("stopped before the start", f"{SET} experiment.stop_speed_rad_s=10 --set experiment.start_speed_rad_s=10", 2,
        ("experiment.stop_speed_rad_s",), "must be below experiment.start_speed_rad_s = 10"),
    Row("a window below a tick", f"{SET} estimator.window_s=0.0001", 2, ("estimator.window_s", "0.0001"),
        "must be at least one period of loop.rate_hz"),
    Row("one channel for two motors", f"{SET} board.brake_pwm=0", 2, ("board.brake_pwm", "0"),
        "another PWM channel than board.drive_pwm = 0"),
    Row("encoders of another rig", "run --rig hard:1 --set encoders.counts_per_turn=4096", 2, ("4096",),
        "set this to 2048"),
    Row("no such profile", f"{SET} profile=usb3", 2, ("'usb3'",), "usb2_generic_0103"),
    Row("no such file of a profile", f"{SET} profile=lab.toml", 2, ("lab.toml",), "inteco-abs profiles lists"),
    Row("a profile without what it is for", f"{SET} profile=lab.toml", 2, ("board.logic_version",), "is missing",
        (file("lab.toml", "[board]\ndrive_pwm = 0\n"),)),
    Row("a profile that names itself", f"{SET} profile=lab.toml", 2, ("board",), "is missing",
        (file("lab.toml", 'profile = "lab.toml"\n'),)),
    Row("no such controller", f"{SET} controller.name=quantum", 2, ("'quantum'",), "known: boundary-layer"),
    Row("nearly an estimator", "run --estimator eular", 2, ("no estimator 'eular'",), "did you mean euler?"),
    Row("code named in a file", f"{SET} controller.name=law.py:Law", 2, ("'law.py:Law'",), "named by --controller"),
    Row("a second place that is none", f"{SET} session.spill=nowhere", 2, ("session.spill", "nowhere"),
        "create it first"),
    Row("an empty key", f"{SET} =0.7", 2, ("--set =0.7",), "must look like guard.brake_limit=0.7"),
    Row("a hundred unknown keys", FILE, 2, ("the configuration has 100 mistakes",), "once these are fixed",
        rig("[guard]\n" + "".join(f"key_{number} = 1\n" for number in range(100)))),
    Row("no such gain to design with", "design --set controller.gains.Mx=1", 2, ("unknown gain",), "Mk"),
    Row("a wrong file to show", "config show --config rig.toml", 2, ("rig.toml",), "config init"),
    Row("a wrong file for a mock", "mock-board --pty --config rig.toml", 2, ("rig.toml",), "config init"),
    Row("a wrong file for a sweep", "sweep --config rig.toml", 2, ("rig.toml",), "config init"),
    Row("a wrong file for a series", "repeat 3 --config rig.toml", 2, ("rig.toml",), "config init"),
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=ids(ROWS))
def test_a_wrong_configuration_gets_one_clear_answer(answers, row):
    answers.to(row)


def test_five_mistakes_are_all_reported_at_once(main_here, tmp_path):
    (tmp_path / "rig.toml").write_text(
        """
        colour = "red"
        [guard]
        brake_limit = 1.5
        [experiment]
        start_speed_rad_s = "180"
        stop_speed = 0.5
        [controller]
        name = "reaching-lw"
        """
    )
    run = main_here("run", "--config", "rig.toml", check=2)
    for line, path in (
        (2, "colour"),
        (4, "guard.brake_limit"),
        (6, "experiment.start_speed_rad_s"),
        (7, "experiment.stop_speed"),
        (9, "controller.name"),
    ):
        assert f"{path} (rig.toml, line {line}): " in run.stderr
    assert "5 mistakes" in run.stderr
