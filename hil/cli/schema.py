"""The command `hil schema`: its options and help text."""

from pathlib import Path

import click

from hil.cli.shared import FILE, finish_lines, reporting


@click.command()
@click.argument("file", type=FILE, required=False)
@reporting
def command(file: Path | None) -> None:
    """Print the path of the JSON Schema of configurations, or write it into the configuration FILE.

    With the schema, editors with a YAML language server complete keys and underline mistakes. FILE gets
    a comment line with the absolute path of this installation's schema; no other line changes.

    \b
    Examples:
      hil schema
      hil schema my.yaml

    Guide: docs/guides/service.md.
    """
    from hil.app.configuration.schema import schema_line, schema_path, with_schema
    from hil.app.configuration.text_file import read_text
    from hil.app.files import write_whole

    lines = [str(schema_path()), f"first line of a configuration: {schema_line()}"]
    if file is not None:
        text = read_text(file)
        named = with_schema(text)
        if named != text:
            write_whole(file, named)
        lines = [f"{file}: {schema_line()}"]
    finish_lines(lines, {"success": True, "kind": "schema", "schema": str(schema_path())})
