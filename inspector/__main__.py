"""The `inspector` command."""

import logging
import os
import sys

import tyro
from rich.console import Console
from rich.markup import escape

from pipeline.exceptions import InputError


def main() -> None:
    """Run a subcommand; what is wrong with the input is told in one line."""
    from inspector.commands.doctor import DoctorConfig
    from inspector.commands.doctor import run as doctor
    from inspector.commands.download import DownloadConfig
    from inspector.commands.download import run as download
    from inspector.commands.serve import ServeConfig
    from inspector.commands.serve import run as serve

    commands = {ServeConfig: serve, DoctorConfig: doctor, DownloadConfig: download}
    logging.basicConfig(level=os.environ.get("INSPECTOR_LOG", "WARNING").upper(), format="%(name)s: %(message)s")
    config = tyro.extras.subcommand_cli_from_dict(
        {"serve": ServeConfig, "doctor": DoctorConfig, "download": DownloadConfig},
        prog="inspector",
        description="See where 6D object poses go wrong, and which stage lost them.",
    )
    try:
        sys.exit(commands[type(config)](config))
    except InputError as error:
        Console(stderr=True, highlight=False).print(f"[bold red]error:[/bold red] {escape(str(error))}", soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
