"""Facts about `fmp-drake reproduce`: a refusal, and claims that fail."""

from fmp_drake.experiments.report import Finding


def test_folder_that_cannot_be_made_is_refused(refused, tmp_path):
    file = tmp_path / "file"
    file.touch()
    for out, reason in (
        (file, "it is a file; name a"),
        (file / "x", "Not a directory"),
    ):
        text = f"cannot write into {out}: {reason}"
        assert text in refused("reproduce", "--out", out)


def test_failed_claim_is_printed_with_its_numbers(command, monkeypatch, tmp_path):
    findings = [
        Finding(name=name, title=name, claim=f"{name} > 1.", shows=shows, agrees=agrees)
        for name, shows, agrees in (("a", "a = 0.5.", False), ("b", "b = 2.", True))
    ]
    monkeypatch.setattr(
        "fmp_drake.apps.reproduce.run_experiments", lambda *_: ([("A", findings)], {})
    )
    printed = command("reproduce", "--quick", "--out", tmp_path / "x").out
    assert "    claim: a > 1.\n    found: a = 0.5.\n" in printed
    assert "found: b" not in printed
