"""``splitknit train WHAT``: one kind for each network."""

from __future__ import annotations

import argparse
from typing import Any

from splitknit.cli.verb import Outcome, Progress, group, new_verb


def add_train(verbs: Any) -> None:
    """Add ``splitknit train`` with its kinds."""
    from splitknit.apps.training.train_relief_verb import add_relief_options  # noqa: PLC0415
    from splitknit.apps.training.train_shape_verb import add_shape_options  # noqa: PLC0415
    from splitknit.apps.training.train_verb import add_separation_options  # noqa: PLC0415

    kinds = group(verbs, "train", "train a network on simulated skin (needs torch)")
    verb = new_verb(kinds, "separation", "the thesis's U-Net, which separates direct light", run_train_separation)
    add_separation_options(verb)
    verb = new_verb(kinds, "relief", "the network of the preset metric, which draws relief and glare", run_train_relief)
    add_relief_options(verb)
    verb = new_verb(kinds, "shape", "the network of the preset metric that mends the shape", run_train_shape)
    add_shape_options(verb)


def run_train_separation(options: argparse.Namespace) -> Outcome:
    """Build the data set and train the network for direct light."""
    from splitknit.apps.training.train_verb import run_separation  # noqa: PLC0415

    with Progress(options) as progress:
        return run_separation(options, progress.update)


def run_train_relief(options: argparse.Namespace) -> Outcome:
    """Simulate the fingers and train the network for relief and glare."""
    from splitknit.apps.training.train_relief_verb import run_relief  # noqa: PLC0415

    with Progress(options) as progress:
        return run_relief(options, progress.update)


def run_train_shape(options: argparse.Namespace) -> Outcome:
    """Simulate and reconstruct the fingers, and train the network that mends the shape."""
    from splitknit.apps.training.train_shape_verb import run_shape  # noqa: PLC0415

    with Progress(options) as progress:
        return run_shape(options, progress.update)
