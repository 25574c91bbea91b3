"""What ``splitknit import`` does with photographs of a rig: many people's, and lights by a table of shadow tips."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from splitknit import BadInput, path, require

if TYPE_CHECKING:
    from splitknit import ImportJob, Outcome, Photographs, Progress, Rig


def rig_of_table(job: ImportJob, taken: Photographs) -> Rig:
    """The rig that a table of tips gives to photographs of this size. Raises BadInput as the calibration does."""
    from splitknit import photographs_in, read_photo
    from splitknit_rig.calibration.jobs import LightsJob
    from splitknit_rig.calibration.lights_job import lights_to_rig

    images, table = path(taken.folder), path(job.table)
    assert images is not None and table is not None and taken.px_per_mm is not None
    found, _, _ = photographs_in(images, table)
    require(len(found) > 0, f"{images} holds no photographs.")
    rows, columns = read_photo(found[0]).pixels.shape[:2]
    circle = {name: getattr(job, name) for name in ("led_height_cm", "led_radius_cm", "led_centre_px", "keep")}
    scale = 10.0 * taken.px_per_mm
    return lights_to_rig(LightsJob(table=table, px_per_cm=scale, image_size=f"{rows},{columns}", **circle)).rig


def import_people(job: ImportJob, progress: Progress) -> Outcome:
    """Write a population of the photographs in a tree, or what of it is missing."""
    from splitknit import PLAN_FILE, open_enrolment, plan_enrolment, read_tree, write_capture

    given, out, people = job.of_finger(), path(job.out), path(job.people)
    assert people is not None
    require(given.crossed is None and given.mosaic is None, "`people` takes neither `crossed` nor `mosaic`.")
    tree = read_tree(people, [str(one) for one in (given.folder, job.nir) if one is not None])
    enrolment = plan_enrolment(out, **tree.plan)
    require(
        not (out / PLAN_FILE).is_file() or plan_enrolment(out).plan == enrolment.plan,
        f"'{out}' is a population of other people, sessions or fingers than this tree; name another folder.",
    )
    waiting = [one for one in tree.captures if job.overwrite or not enrolment.finished(one[0])]
    faults, written = list(tree.faults), 0
    notes: dict[str, None] = {}
    if waiting and not job.dry_run:
        given = job.with_table(replace(given, folder=waiting[0][1][0]))
        for k, (place, (images, *nir)) in enumerate(waiting):
            progress(place.words, k / len(waiting))
            about = {"id": place.subject, "finger": place.finger, "session": place.session}
            try:
                capture, told = replace(given, folder=images, nir=nir[0] if nir else None).read()
            except BadInput as error:
                faults.append(f"{place.words}: {error}")
                continue
            open_enrolment(out, **tree.plan)
            notes |= dict.fromkeys(told)
            write_capture(replace(capture, subject=about), enrolment.path(place), overwrite=job.overwrite)
            written += 1
    why = " ".join(faults[len(tree.faults) :][:1] or faults[:1])
    require(bool(written or job.dry_run or enrolment.folder.exists()), f"nothing was written: {why}")
    there, planned = len(tree.captures) - len(waiting), enrolment.plan.total
    facts: dict[str, Any] = {"out": str(out), "dry_run": job.dry_run, **tree.plan, "faults": faults}
    facts |= {"notes": list(notes), "planned": planned, "written": written, "there_already": there}
    facts["captures"] = {place.folder: [str(one) for one in paths] for place, paths in tree.captures}
    lines = [f"{place.folder}: {', '.join(map(str, paths))}" for place, paths in waiting if job.dry_run]
    did = f"{len(waiting)} would be written" if job.dry_run else f"{written} written to {out}"
    lines += [f"{planned} captures planned, {len(tree.captures)} complete: {did}, {there} there already."]
    lines += [f"Please note: {one}" for one in (*faults, *notes)]
    return facts, [*lines, f"Next: splitknit batch {out} --out STORE"]
