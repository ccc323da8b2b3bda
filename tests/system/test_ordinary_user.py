import json
import subprocess

import pytest

pytestmark = [pytest.mark.xdist_group("real time"), pytest.mark.untraced]


@pytest.mark.long
def test_an_ordinary_user_runs_in_real_time_and_sees_what_was_refused(
    command_path, inteco_abs, untraced, tmp_path, without_privileges
):
    quick = ("--set", "experiment.start_speed_rad_s=30", "--set", "experiment.hold_s=0.1", "--set", "loop.rate_hz=500")
    run = subprocess.run(
        [*without_privileges, command_path, "run", "--out", "stop.mcap", "--json", *quick],
        cwd=tmp_path, env=untraced, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert run.returncode in (0, 3), run.stderr  # a busy machine delays an ordinary process
    card = json.loads(run.stdout)
    assert (card["outcome"], card["lost_ticks"]) == ("completed", 0)
    facts = json.loads(inteco_abs("info", "stop.mcap", "--json", check=0).stdout)["metadata"]
    refused = {name for name, value in facts["realtime"].items() if value.startswith("refused: ")}
    limits = facts["doctor"]["priority_limit"]
    assert ("scheduler" in refused) == limits.startswith("red"), limits
    if refused:
        assert "ticks will be late more often: the system refused" in run.stderr
    assert json.loads(inteco_abs("replay", "stop.mcap", "--json", check=0).stdout)["differing"] == 0


def test_a_file_that_may_not_be_read_is_wrong_and_the_others_are_looked_at(
    command_path, untraced, tmp_path, without_privileges
):
    (tmp_path / "secret.mcap").touch(mode=0)
    (tmp_path / "text.mcap").write_text("no session")
    validate = subprocess.run(
        [*without_privileges, command_path, "validate", "secret.mcap", "text.mcap"],
        cwd=tmp_path, env=untraced, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert validate.returncode == 1
    assert "secret.mcap: file: wrong: cannot be read: Permission denied" in validate.stdout
    assert "text.mcap: file: wrong: is not an MCAP file" in validate.stdout
