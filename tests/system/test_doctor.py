import json

import pytest

QUICK = ("doctor", "--seconds", "0.2")
ORDER = ("green", "amber", "red")
ALWAYS = {
    "kernel", "lockdown", "CPUs", "CPU governor", "sleep states", "clock source", "real-time share", "load",
    "priority limit", "memory limit", "group", "udev rules", "board", "free space", "shared memory", "Python",
    "disk speed", "loop settings", "wake-ups",
}  # fmt: skip


def test_the_doctor_gives_every_finding_as_json(inteco_abs, tmp_path):
    run = inteco_abs(*QUICK, "--json")
    report = json.loads(run.stdout)
    assert set(report) == {"schema_version", "verdict", "findings", "rules", "limits"}
    assert report["schema_version"] == 1
    findings = {finding["name"]: finding for finding in report["findings"]}
    assert set(findings) >= ALWAYS
    for finding in findings.values():
        assert set(finding) == {"name", "verdict", "found", "fix"}
        assert finding["found"]
        assert bool(finding["fix"]) == (finding["verdict"] != "green")
    verdicts = [ORDER.index(finding["verdict"]) for finding in findings.values()]
    assert report["verdict"] == ORDER[max(verdicts)]
    assert run.returncode == (3 if report["verdict"] == "red" else 0)
    assert list(tmp_path.iterdir()) == []


def test_the_doctor_gives_every_finding_as_text(main_here):
    run = main_here(*QUICK)
    assert run.returncode in {0, 3}
    for name in ALWAYS:
        assert f"{name} " in run.stdout
    last = run.stdout.strip().splitlines()[-1]
    assert (run.returncode == 3) == last.startswith("red ")


@pytest.mark.parametrize("option", ["rules", "limits"])
def test_files_to_install_are_printed_alone_for_tee(main_here, option):
    alone = main_here("doctor", f"--{option}", check=0)
    assert alone.stderr == ""
    assert alone.stdout == json.loads(main_here(*QUICK, "--json").stdout)[option]
    as_json = json.loads(main_here("doctor", f"--{option}", "--json", check=0).stdout)
    assert as_json == {"schema_version": 1, option: alone.stdout}
    assert {"rules": 'TAG+="uaccess"', "limits": "memlock unlimited"}[option] in alone.stdout


def test_what_lies_in_the_users_folder_is_not_run(inteco_abs, tmp_path):
    (tmp_path / "json.py").write_text("raise SystemExit(9)\n")
    wakes = json.loads(inteco_abs(*QUICK, "--json").stdout)["findings"][-1]
    assert wakes["name"] == "wake-ups"
    assert "periods missed" in wakes["found"]
