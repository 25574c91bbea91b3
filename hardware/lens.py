"""Draw how the lens is glued, reached and focused: ``python -m hardware.lens --out docs/images``
writes ``rig-lens.svg``, to scale.
"""

from __future__ import annotations

from collections.abc import Sequence

from hardware import sizes
from hardware.films import rig_of
from hardware.geometry import RigDimensions, dimensions_of

NAME = "rig-lens.svg"
PIXEL_MM = 0.00112
"""Side of a pixel. Source: Sony IMX219 (Raspberry Pi camera v2)."""
BLUR_PX = 2.0
"""Blur, in pixels, of what still counts as sharp."""
STOPS = (5.6, 2.0)
FOCUS_MM = 1.0
"""Height over the finger plane of the disc that hangs from a ruler across the open tube."""
NIR_SHIFT_MM = 6.0
"""How far out of focus the twin's NIR pictures were. Source: validation/rig_check/effects.py."""
INK = "#222222"
GREY = "#D5D5D5"
SKIN = "#F0C8A8"
WHITE = "#C77700"
NIR = "#B03A2E"
HAND = "#1F5FA8"


class Panel:
    """A part of the drawing with its own origin (pixels) and scale (pixels per mm); z is up."""

    def __init__(self, x0: float, y0: float, scale: float) -> None:
        """Place the origin; there are no shapes yet."""
        self.x0, self.y0, self.scale = x0, y0, scale
        self.shapes: list[str] = []

    def at(self, x: float, z: float) -> tuple[float, float]:
        """Pixels of a place in mm."""
        return self.x0 + self.scale * x, self.y0 - self.scale * z

    def path(self, points: Sequence[tuple[float, float]], style: str) -> None:
        """Lines from point to point."""
        places = (self.at(*point) for point in points)
        line = "L".join(f"{u:.1f} {v:.1f}" for u, v in places)
        self.shapes.append(f'<path d="M{line}" {style}/>')

    def box(self, x: tuple[float, float], z: tuple[float, float], fill: str) -> None:
        """A filled rectangle."""
        corners = [(x[0], z[0]), (x[1], z[0]), (x[1], z[1]), (x[0], z[1]), (x[0], z[0])]
        self.path(corners, f'fill="{fill}" stroke="{INK}"')

    def sides(self, x: tuple[float, float], z: tuple[float, float], fill: str) -> None:
        """The same rectangle right and left of the axis."""
        self.box(x, z, fill)
        self.box((-x[0], -x[1]), z, fill)

    def size(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """A line with an arrow at both ends."""
        ends = 'marker-start="url(#tip)" marker-end="url(#tip)"'
        self.path([start, end], f'stroke="{INK}" {ends}')

    def text(
        self, x: float, z: float, *lines: str, colour: str = INK, anchor: str = "start"
    ) -> None:
        """Lines of text, the first one's foot at the place."""
        u, v = self.at(x, z)
        for k, line in enumerate(lines):
            self.shapes.append(
                f'<text x="{u:.1f}" y="{v + 17 * k:.1f}" fill="{colour}" text-anchor="{anchor}">'
                f"{line}</text>"
            )


def focal_mm(d: RigDimensions) -> float:
    """Focal length of a thin lens that gives the rig's pixels per millimetre."""
    enlargement: float = d.settings.rig.px_per_mm * PIXEL_MM
    return d.camera_height_mm * enlargement / (1 + enlargement)


def blur_mm(d: RigDimensions, stop: float, away_mm: float) -> float:
    """Blur, measured in the focused plane, of what lies `away_mm` above it."""
    distance = d.camera_height_mm - FOCUS_MM
    return focal_mm(d) / stop * away_mm / (distance - away_mm)


def depth_mm(d: RigDimensions, stop: float) -> float:
    """Depth of field around the finger plane: blur of at most `BLUR_PX` pixels on it."""
    blur: float = BLUR_PX / d.settings.rig.px_per_mm
    return 2 * blur * d.camera_height_mm * stop / focal_mm(d)


def figure(d: RigDimensions) -> str:
    """The drawing as SVG."""
    panels = (_tube(d), _holder(d), _depth(d))
    shapes = "\n".join(shape for panel in panels for shape in panel.shapes)
    return f"""<svg xmlns="http://www.w3.org/2000/svg" width="1420" height="590" \
viewBox="0 0 1420 590" font-family="sans-serif" font-size="14" role="img" \
aria-label="The lens: reached from below, glued, and its depth of field">
<defs><marker id="tip" viewBox="0 0 10 10" refX="10" refY="5" markerWidth="9" markerHeight="9" \
orient="auto-start-reverse"><path d="M0 1L10 5L0 9z" fill="context-stroke"/></marker></defs>
<rect width="1420" height="590" fill="white"/>
<g fill="none">
{shapes}
</g>
</svg>
"""


def _lens(panel: Panel, d: RigDimensions, reach_mm: float) -> None:
    """Frame, as far as `reach_mm`, board, sensor, holder and lens; the last three are drawn freely
    where ``dimensions.toml`` says nothing.
    """
    camera, high = d.settings.camera, d.board_z_mm
    front, top = d.camera_height_mm - camera.barrel_front_mm, d.frame_z_mm + sizes.JOINT_PLATE_MM
    panel.sides((d.lens_hole_mm, reach_mm), (d.frame_z_mm, top), GREY)
    panel.box((-camera.board_y_mm / 2, camera.board_y_mm / 2), (high, high + 1.6), "#7FB08A")
    panel.box((-1.9, 1.9), (high - 1.0, high), "#555555")
    panel.sides((6.0, 7.8), (top + 0.3, high), "#8C8C8C")
    panel.box((-6.0, 6.0), (d.camera_height_mm, high - 2.6), "#C9DCEB")
    panel.box((-camera.barrel_mm / 2, camera.barrel_mm / 2), (front, d.camera_height_mm), "#C9DCEB")


def _tube(d: RigDimensions) -> Panel:
    p = Panel(205.0, 500.0, 2.5)
    finger, floor, wall = d.settings.finger, d.floor_z_mm, d.settings.joint.wall_mm
    p.text(-74.0, 186.0, "<tspan font-weight='bold'>1. Reached through the open tube</tspan>")
    roof = floor + finger.hand_height_mm + finger.hand_width_mm / 2
    front = d.camera_height_mm - d.settings.camera.barrel_front_mm
    p.box((d.bore_mm, d.outer_mm), (floor, d.box_z_mm), GREY)
    p.box((-d.outer_mm, -d.bore_mm), (roof, d.box_z_mm), GREY)
    p.box((-d.outer_mm, d.niche_inner_y_mm), (roof, roof + 1.4 * wall), GREY)
    p.box((d.niche_y_mm, d.niche_inner_y_mm), (floor + d.opening_radius_mm, roof), GREY)
    _lens(p, d, d.bore_mm)
    base = f'fill="white" stroke="{INK}" stroke-dasharray="5 3"'
    corners = [(-d.ring_mm, d.base_z_mm), (d.ring_mm, d.base_z_mm), (d.ring_mm, floor)]
    p.path([*corners, (-d.ring_mm, floor), corners[0]], base)
    stop = (d.stop_y_mm, d.stop_y_mm + wall)
    p.box(stop, (d.groove_z_mm, d.groove_z_mm + finger.stop_height_mm), "white")
    u, v = p.at(-85.0, 0.0)
    end, thick = p.at(d.stop_y_mm, 0.0)[0], p.scale * finger.pad_height_mm
    p.shapes.append(
        f'<path d="M{u:.1f} {v:.1f}H{end - 20:.1f}q20 0 20 {thick / 2:.1f}'
        f't-20 {thick / 2:.1f}H{u:.1f}" fill="{SKIN}" stroke="{INK}"/>'
    )
    p.text(-72.0, -8.0, "finger")
    p.text(-58.0, d.base_z_mm - 9.0, "base: off while the lens is turned")
    p.size((0.0, 0.0), (0.0, front))
    p.size((-14.0, 0.0), (-14.0, d.camera_height_mm))
    p.path([(-16.0, d.camera_height_mm), (0.0, d.camera_height_mm)], f'stroke="{INK}"')
    p.text(-16.0, 80.0, f"{d.camera_height_mm:g}", anchor="end")
    p.text(2.0, 80.0, f"{front:g}")
    p.size((-d.bore_mm, 118.0), (d.bore_mm, 118.0))
    p.text(-58.0, 121.0, f"tube {2 * d.bore_mm:g} inside")
    p.path(
        [(38.0, d.base_z_mm - 6.0), (38.0, 100.0), (9.0, front + 3.0)],
        f'stroke="{HAND}" stroke-width="3" marker-end="url(#tip)"',
    )
    p.text(36.0, 52.0, f"hand: {front - floor:.0f}", colour=HAND, anchor="end")
    p.text(-58.0, 152.0, "camera")
    return p


def _holder(d: RigDimensions) -> Panel:
    scale = 10.0
    p = Panel(590.0, 260.0 + scale * d.camera_height_mm, scale)
    camera, high = d.settings.camera, d.board_z_mm
    front = d.camera_height_mm - camera.barrel_front_mm
    u = p.at(0.0, 0.0)[0]
    p.shapes.append(
        f'<text x="{u - 145:.1f}" y="35" fill="{INK}" font-weight="bold">2. Glued and turned</text>'
    )
    _lens(p, d, 15.0)
    for side in (-1.0, 1.0):
        foot = [(side * 7.8, high), (side * 10.0, high), (side * 7.8, high - 2.2)]
        p.path(foot, 'fill="black"')
    p.path([(-7.8, high), (-9.0, high), (-7.8, high - 1.2)], 'fill="#FFC93C"')
    p.path([(-8.2, high - 0.3), (-11.0, high + 4.0)], f'stroke="{INK}"')
    p.text(-14.5, high + 6.2, "first UV resin", "on two corners")
    p.path([(8.6, high - 0.4), (10.0, high + 4.0)], f'stroke="{INK}"')
    p.text(4.0, high + 6.2, "then black glue", "all round")
    p.text(-1.0, high + 2.4, "board", anchor="middle")
    p.text(0.0, high - 2.2, "sensor", anchor="middle")
    p.text(0.0, d.camera_height_mm + 4.5, "lens in", "M12 x 0.5", anchor="middle")
    p.text(9.3, d.frame_z_mm + 1.7, "frame")
    p.path([(7.0, high - 3.5), (12.0, high - 3.5)], f'stroke="{INK}"')
    p.text(12.3, high - 3.9, "holder")
    for side in (-1.0, 1.0):
        tip, edge = p.at(side * (camera.barrel_mm / 2 + 0.1), front + 3.0), side * p.scale
        p.shapes.append(
            f'<path d="M{tip[0]:.1f} {tip[1]:.1f}q0 {-2.5 * scale:.1f} {3 * edge:.1f} '
            f"{-1.5 * scale:.1f}q{4 * edge:.1f} {3 * scale:.1f} {4 * edge:.1f} {12 * scale:.1f}"
            f"h{-4 * edge:.1f}q0 {-6 * scale:.1f} {-3 * edge:.1f} {-10.5 * scale:.1f}z"
            f'" fill="{SKIN}" stroke="{HAND}"/>'
        )
    p.size((-3.0, front), (-3.0, d.camera_height_mm))
    p.text(-2.5, front + 3.6, f"{camera.barrel_front_mm:g}")
    p.size((-10.5, d.camera_height_mm), (-10.5, high))
    p.path([(-11.0, d.camera_height_mm), (-6.0, d.camera_height_mm)], f'stroke="{INK}"')
    p.text(-11.0, high - 3.9, f"{camera.board_above_lens_mm:g}", anchor="end")
    steps = 8
    enlargement = d.settings.rig.px_per_mm * PIXEL_MM
    moved = 0.5 / steps / enlargement**2
    p.text(
        0.0, front - 3.0, f"1/{steps} of a turn:", f"focus moves {moved:.0f}",
        anchor="middle", colour=HAND,
    )  # fmt: skip
    p.text(0.0, front - 14.0, "All lengths in mm", anchor="middle")
    return p


def _depth(d: RigDimensions) -> Panel:
    p = Panel(955.0, 275.0, 13.0)
    finger = d.settings.finger
    p.shapes.append(
        f'<text x="{p.x0 - 110:.1f}" y="35" fill="{INK}" font-weight="bold">'
        "3. Sharp at this height</text>"
    )
    right = 23.5
    for stop, colour in zip(STOPS, ("#DDF0DD", "#8CCB8C"), strict=True):
        half = depth_mm(d, stop) / 2
        low, high = FOCUS_MM - half, FOCUS_MM + half
        outline = [(-9.0, low), (right, low), (right, high), (-9.0, high)]
        p.path(outline, f'fill="{colour}"')
    u, v = p.at(0.0, -finger.pad_height_mm / 2)
    across, thick = 8.5 * p.scale, p.scale * finger.pad_height_mm / 2
    p.shapes.append(
        f'<ellipse cx="{u:.1f}" cy="{v:.1f}" rx="{across:.1f}" ry="{thick:.1f}" fill="{SKIN}" '
        f'stroke="{INK}"/>'
    )
    p.text(0.0, -8.5, "finger, cut across", anchor="middle")
    p.box((11.5, 22.5), (-sizes.DISC_MM, 0.0), "white")
    p.text(17.0, -4.2, "calibration disc", anchor="middle")
    p.path(
        [(17.0 - sizes.NAIL_RADIUS_MM, 0.0), (17.0, d.nail_mm), (17.0 + sizes.NAIL_RADIUS_MM, 0.0)],
        f'fill="{GREY}" stroke="{INK}"',
    )
    p.size((13.0, 0.0), (13.0, d.nail_mm))
    p.text(12.5, 9.0, f"nail {d.nail_mm:g}", anchor="end")
    p.size((-10.5, -finger.pad_height_mm), (-10.5, 0.0))
    p.text(-11.0, -7.5, f"{finger.pad_height_mm:g}", anchor="end")
    p.path([(-11.0, 0.0), (right, 0.0)], f'stroke="{INK}"')
    p.path([(-9.0, FOCUS_MM), (right, FOCUS_MM)], f'stroke="{WHITE}" stroke-width="2"')
    nir = FOCUS_MM - NIR_SHIFT_MM
    p.path([(-9.0, nir), (right, nir)], f'stroke="{NIR}" stroke-width="2" stroke-dasharray="7 4"')
    wide, narrow = STOPS[1], STOPS[0]
    green = "#2E7D32"
    p.text(
        right + 0.5, 6.0, f"sharp: {depth_mm(d, wide):.1f} at f/{wide:g},",
        f"{depth_mm(d, narrow):.1f} (pale) at f/{narrow:g}", colour=green,
    )  # fmt: skip
    p.text(right + 0.5, 1.6, f"white focus, {FOCUS_MM:g} up", colour=WHITE)
    p.text(right + 0.5, -0.5, "finger plane")
    p.text(
        right + 0.5, nir + 0.6, "850 nm focus: differs", "in each lens;",
        f"drawn {NIR_SHIFT_MM:g} deeper", colour=NIR,
    )  # fmt: skip
    away = d.nail_mm - FOCUS_MM
    blurs = [blur_mm(d, stop, away) for stop in (wide, narrow)]
    p.text(
        right - 4.5, d.nail_mm - 0.6, f"tip blurs to {blurs[0]:.1f} at f/{wide:g},",
        f"{blurs[1]:.1f} at f/{narrow:g}",
    )  # fmt: skip
    return p


def main() -> None:
    """Write the drawing."""
    options = sizes.arguments(__doc__ or "", "parts")
    s = sizes.read_dimensions(options.dimensions)
    rig = rig_of(s)
    s.rig.px_per_mm = rig.camera.px_per_mm  # a rig file's own
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / NAME).write_text(figure(dimensions_of(rig, s)), encoding="utf-8")


if __name__ == "__main__":
    main()
