"""The `inspector` command."""

import logging
import os
import sys

import tyro
from rich.console import Console
from rich.markup import escape

from inspector.commands.calibrate import CalibrateConfig
from inspector.commands.calibrate import run as run_calibrate
from inspector.commands.check import CheckConfig
from inspector.commands.check import run as run_check
from inspector.commands.depth_correct import DepthCorrectConfig
from inspector.commands.depth_correct import run as run_depth_correct
from inspector.commands.doctor import DoctorConfig
from inspector.commands.doctor import run as run_doctor
from inspector.commands.download import DownloadConfig
from inspector.commands.download import run as run_download
from inspector.commands.evaluate import EvaluateConfig
from inspector.commands.evaluate import run as run_evaluate
from inspector.commands.gt_info import GtInfoConfig
from inspector.commands.gt_info import run as run_gt_info
from inspector.commands.gt_quality import GtQualityConfig
from inspector.commands.gt_quality import run as run_gt_quality
from inspector.commands.record import RecordConfig
from inspector.commands.record import run as run_record
from inspector.commands.run import RunConfig
from inspector.commands.run import run as run_run
from inspector.commands.serve import ServeConfig
from inspector.commands.serve import run as run_serve
from inspector.commands.symmetries import SymmetriesConfig
from inspector.commands.symmetries import run as run_symmetries
from inspector.commands.synthesize import SynthesizeConfig
from inspector.commands.synthesize import run as run_synthesize
from inspector.commands.trace import TraceConfig
from inspector.commands.trace import run as run_trace
from inspector.commands.train import TrainConfig
from inspector.commands.train import run as run_train
from pipeline.exceptions import InputError


def main() -> None:
    """Run a subcommand; what is wrong with the input is told in one line."""
    commands = {
        "serve": (ServeConfig, run_serve),
        "evaluate": (EvaluateConfig, run_evaluate),
        "check": (CheckConfig, run_check),
        "train": (TrainConfig, run_train),
        "run": (RunConfig, run_run),
        "record": (RecordConfig, run_record),
        "trace": (TraceConfig, run_trace),
        "doctor": (DoctorConfig, run_doctor),
        "gt-info": (GtInfoConfig, run_gt_info),
        "gt-quality": (GtQualityConfig, run_gt_quality),
        "calibrate": (CalibrateConfig, run_calibrate),
        "depth-correct": (DepthCorrectConfig, run_depth_correct),
        "synthesize": (SynthesizeConfig, run_synthesize),
        "symmetries": (SymmetriesConfig, run_symmetries),
        "download": (DownloadConfig, run_download),
    }
    level = logging.getLevelNamesMapping().get(os.environ.get("INSPECTOR_LOG", "").upper(), logging.WARNING)
    logging.basicConfig(level=level, format="%(name)s: %(message)s")
    try:
        config = tyro.extras.subcommand_cli_from_dict(
            {name: kind for name, (kind, _) in commands.items()},
            prog="inspector",
            description="See where 6D object poses go wrong, and which stage lost them.",
        )
        run = {kind: run for kind, run in commands.values()}[type(config)]
        sys.exit(run(config))
    except BrokenPipeError:  # what reads our output, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except InputError as error:
        Console(stderr=True, highlight=False).print(f"[bold red]error:[/bold red] {escape(str(error))}", soft_wrap=True)
        sys.exit(2)
    except OSError as error:
        text = f"{error.filename or 'the system'}: {error.strerror}; check the path and its permissions"
        Console(stderr=True, highlight=False).print(f"[bold red]error:[/bold red] {escape(text)}", soft_wrap=True)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
