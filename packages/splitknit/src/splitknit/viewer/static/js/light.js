// Where the light comes from: two sliders, a pad, or the pointer over the surface; all set the same direction.
import { byId } from "./page.js";

export class Light {
  /** @param {any} look @param {() => void} changed */
  constructor(look, changed) {
    this.look = look;
    this.changed = changed;
    for (const name of ["azimuth", "elevation"]) {
      byId(name).addEventListener("input", () => this.set({ [name]: byId(name).valueAsNumber }));
    }
    this.follow(byId("pad"), () => true);
    byId("lamp").addEventListener("change", () => {
      this.look.lamp = byId("lamp").checked ? "finger" : "camera";
      this.changed();
    });
    this.set({});
  }

  /** @param {{azimuth?: number, elevation?: number}} values degrees */
  set(values) {
    Object.assign(this.look, values);
    this.look.azimuth = Math.round((this.look.azimuth + 360) % 360) % 360;
    this.look.elevation = Math.round(Math.min(90, Math.max(2, this.look.elevation)));
    for (const name of ["azimuth", "elevation"]) {
      byId(name).value = this.look[name];
      byId(`${name}-value`).textContent = `${this.look[name]}°`;
    }
    const reach = Math.cos((this.look.elevation * Math.PI) / 180);
    const angle = (this.look.azimuth * Math.PI) / 180;
    const dot = byId("pad").firstElementChild;
    dot.style.left = `${50 + 46 * reach * Math.cos(angle)}%`;
    dot.style.top = `${50 - 46 * reach * Math.sin(angle)}%`;
    this.changed();
  }

  /** Let the pointer over `element` set where the lamp is: its middle is overhead, its rim is level with the skin. */
  follow(element, wanted) {
    const aim = (event) => {
      const box = element.getBoundingClientRect();
      const half = Math.min(box.width, box.height) / 2;
      const x = (event.clientX - box.left - box.width / 2) / half;
      const y = -(event.clientY - box.top - box.height / 2) / half;
      const reach = Math.min(1, Math.hypot(x, y));
      const azimuth = reach < 0.02 ? this.look.azimuth : (Math.atan2(y, x) * 180) / Math.PI;
      this.set({ azimuth, elevation: (Math.acos(reach) * 180) / Math.PI });
    };
    element.addEventListener("pointerdown", (event) => {
      if (!wanted() || event.button !== 0) return;
      element.setPointerCapture(event.pointerId);
      aim(event);
    });
    element.addEventListener("pointermove", (event) => {
      if (wanted() && event.buttons & 1) aim(event);
    });
  }
}
