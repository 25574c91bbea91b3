"""What the program says of verbs that left it."""

from splitknit.cli.main import main
from splitknit.registry import GONE


def test_a_removed_verb_names_its_replacement(monkeypatch, capsys):
    monkeypatch.setitem(GONE, "rig paint", "use a brush.")
    assert main(["rig", "paint", "--red"]) == 2
    assert (
        capsys.readouterr().err == "splitknit: error: 'rig paint' left the program: use a brush.\n"
    )
