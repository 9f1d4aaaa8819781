"""`hil schema FILE`: the configuration names its schema, and stays the one it was."""

import pytest
from click.testing import CliRunner

from hil.app.configuration.configuration import load
from hil.app.configuration.schema import MODELINE, named_schema, schema_path
from hil.cli import main

MARK = "\ufeff"


@pytest.mark.parametrize("head", ["", f"{MODELINE}elsewhere.json\n", f"# mine\n{MODELINE}elsewhere.json\n"])
def test_a_configuration_with_a_byte_order_mark_is_as_good_with_its_schema_named_once(head, tmp_path):
    path = tmp_path / "my.yaml"
    text = load("ideal").text
    body = text[text.index("\nname:") + 1 :]
    path.write_text(f"{MARK}{head}{body}", encoding="utf-8")
    before = load(path)
    assert named_schema(before.text) == ("elsewhere.json" if head else None)
    assert CliRunner().invoke(main, ["schema", str(path)]).exit_code == 0
    named = path.read_text(encoding="utf-8")
    assert named.count(MODELINE) == 1
    assert named_schema(named) == str(schema_path())
    assert named.endswith(body)
    assert load(path).name == before.name == "ideal"
