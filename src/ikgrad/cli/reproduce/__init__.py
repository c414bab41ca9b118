"""``ikgrad reproduce``: the tables and figures of the papers, one module a paper."""

from __future__ import annotations

from ikgrad.cli.parsing import Commands, example
from ikgrad.cli.reproduce import apps, denso, puma, trajectory


def add(commands: Commands) -> None:
    """Add the command and its papers."""
    text = "reproduce a paper: its tables beside ours, its figures"
    parser = commands.add_parser(
        "reproduce", help=text, description=text, epilog=example("ikgrad reproduce apps --out out")
    )
    papers = parser.add_subparsers(dest="paper", metavar="PAPER", required=True, title="papers")
    apps.add(papers)
    puma.add(papers)
    denso.add(papers)
    trajectory.add(papers)
