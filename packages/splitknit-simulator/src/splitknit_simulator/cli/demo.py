"""``splitknit demo``: a simulated finger, reconstructed twice and compared with the truth."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

from splitknit.cli.verb import Outcome, Verb
from splitknit.verbs import AnyPath, Help, Job, Natural, Progress, Scale, path


@dataclass(frozen=True, slots=True)
class DemoJob(Job):
    """Simulate a finger, reconstruct it, compare it with the truth."""

    _: KW_ONLY
    out: Annotated[AnyPath, Help("folder to write", "DIR")] = Path("demo")
    seed: Annotated[Natural, Help("which finger")] = 1
    scale: Annotated[Scale, Help("size of the images, 1 = 3200 x 2200 pixels")] = 0.5

    def run(self, progress: Progress) -> dict[str, Any]:
        """Simulate, reconstruct, compare."""
        from splitknit_simulator.demo import demo  # verbs import what they need, so that --help is quick

        return demo(path(self.out), seed=self.seed, scale=self.scale, progress=progress)


def _show(facts: dict[str, Any], job: DemoJob) -> Outcome:
    lines = [
        f"A simulated finger was photographed, reconstructed and compared with the truth in {facts['total_s']:.0f} s."
    ]
    for preset, figure in facts["comparison"].items():
        lines.append(
            f"  {preset:7s} surface rms {figure['surface_rms_mm']:.3f} mm, "
            f"ridge correlation {figure['ridge_correlation']:.2f}, ridge gain {figure['ridge_gain']:.2f}"
        )
    out = path(job.out)
    lines += [f"Open {out / 'report.html'} in a browser. Also written:"]
    lines += [f"  {out / name}: {what}" for name, what in facts["written"].items()]
    return facts, lines


DEMO = Verb(DemoJob, _show)
