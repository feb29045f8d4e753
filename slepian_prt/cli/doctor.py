"""``slepian-prt doctor``."""

from __future__ import annotations

import json

import click

from slepian_prt.cli.backend import variant_option
from slepian_prt.cli.options import json_option
from slepian_prt.errors import printable


@click.command()
@json_option
@variant_option
def doctor(as_json: bool) -> int:
    """What runs here: Mitsuba, variant, LLVM, cores, speed; and how to mend what does not."""
    from slepian_prt.cli.machine import examine

    findings = examine()
    healthy = all(finding.ok for finding in findings)
    if as_json:
        click.echo(json.dumps({"ok": healthy, "findings": [finding.as_dict() for finding in findings]}, indent=1))
    else:
        width = max(len(finding.subject) for finding in findings)
        for finding in findings:
            click.echo(f"{'ok ' if finding.ok else '!! '} {finding.subject:<{width}}  {printable(finding.value)}")
            if finding.remedy:
                click.echo(f"    {'':<{width}}  -> {finding.remedy}")
    return 0 if healthy else 2
