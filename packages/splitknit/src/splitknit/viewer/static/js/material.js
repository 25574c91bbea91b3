// How a surface is lit and coloured. The relief is exaggerated here, so that no data are sent again.
import { Color, DataTexture, DoubleSide, LinearFilter, Matrix2, ShaderMaterial, Vector2, Vector3 } from "../vendor/three/three.module.min.js";
import { ramp } from "./colour.js";

export const COLOURS = ["clay", "height", "relief", "normals", "albedo", "difference", "specular"];

const VERTEX = `
attribute float ridge;   // relief, mm
attribute vec4 slopes;   // of the height (x, y) and of the relief (z, w)
uniform float relief;
varying vec3 vNormal;
varying float vHeight;
varying float vRidge;
varying vec2 vPlace;
void main() {
  float facing = 1.0 / (1.0 + dot(slopes.xy, slopes.xy));
  float extra = (relief - 1.0) * clamp(2.0 * facing, 0.0, 1.0);  // less on steep flanks, where ridges would overhang
  vec3 place = position;
  place.z += extra * ridge;
  vNormal = normalMatrix * normalize(vec3(-(slopes.xy + extra * slopes.zw), 1.0));
  vHeight = position.z;
  vRidge = ridge;
  vPlace = uv;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(place, 1.0);
}`;

const FRAGMENT = `
uniform int colour;
uniform vec3 light;       // towards the lamp, as the viewer stands
uniform vec2 heights;     // mm
uniform float reliefs;    // mm
uniform float contours;   // mm, 0 for none
uniform mat2 turn;
uniform sampler2D scale;
uniform sampler2D picture;
varying vec3 vNormal;
varying float vHeight;
varying float vRidge;
varying vec2 vPlace;
void main() {
  vec3 n = normalize(vNormal);
  bool back = !gl_FrontFacing;
  if (back) n = -n;
  float key = max(dot(n, light), 0.0);
  float fill = max(dot(n, normalize(vec3(0.4, -0.1, 0.9))), 0.0);
  float gloss = pow(max(dot(n, normalize(light + vec3(0.0, 0.0, 1.0))), 0.0), 24.0);
  vec3 base = vec3(0.90, 0.80, 0.70);
  float shade = 0.10 + 0.74 * key + 0.20 * fill;
  float shine = 0.10 * gloss;
  if (colour == 1) base = texture2D(scale, vec2((vHeight - heights.x) / (heights.y - heights.x), 0.5)).rgb;
  if (colour == 2) base = texture2D(scale, vec2(0.5 + 0.5 * vRidge / reliefs, 0.5)).rgb;
  if (colour == 1 || colour == 2) { shade = 0.30 + 0.55 * key + 0.20 * fill; shine = 0.04 * gloss; }
  if (colour == 3) {
    vec3 m = texture2D(picture, vPlace).rgb * 2.0 - 1.0;
    base = vec3(turn * m.xy, m.z) * 0.5 + 0.5;
    shade = 1.0; shine = 0.0;
  }
  if (colour == 4) { base = texture2D(picture, vPlace).rrr; shade = 0.45 + 0.45 * key + 0.15 * fill; shine = 0.0; }
  if (colour == 6) { base = texture2D(picture, vPlace).rrr; shade = 1.0; shine = 0.0; }
  if (colour == 5) {
    float apart = 255.0 * texture2D(picture, vPlace).r;  // 0 is unknown, 128 is none
    base = mix(vec3(0.55), texture2D(scale, vec2(0.5 + (apart - 128.0) / 254.0, 0.5)).rgb, step(0.5, apart));
    shade = 0.45 + 0.40 * key + 0.20 * fill; shine = 0.0;
  }
  vec3 lit = shade * base + shine;
  if (colour == 0) lit = pow(clamp(lit * (1.0 + 0.14 * clamp(vRidge / (0.8 * reliefs), -1.0, 1.0)), 0.0, 1.0), vec3(0.8));
  if (contours > 0.0) {
    float level = vHeight / contours;
    float width = max(fwidth(level), 1e-6);
    float line = 1.0 - smoothstep(0.6, 1.4, abs(fract(level - 0.5) - 0.5) / width);
    lit = mix(lit, vec3(0.05), 0.75 * line * step(width, 0.5));
  }
  if (back) lit = vec3(0.30 + 0.25 * fill);
  gl_FragColor = vec4(clamp(lit, 0.0, 1.0), 1.0);
}`;

/** @param {"height" | "relief"} name */
function scaleTexture(name) {
  const texture = new DataTexture(ramp(name), 256, 1);
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

/** @param {any} meta facts about a result */
export function makeMaterial(meta) {
  const blank = new DataTexture(new Uint8Array([200, 200, 200, 255]), 1, 1);
  blank.needsUpdate = true;
  const [[a, b], [c, d]] = meta.turn;
  return new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    side: DoubleSide,
    uniforms: {
      relief: { value: 1 },
      colour: { value: 0 },
      light: { value: new Vector3(0, 0, 1) },
      heights: { value: new Vector2(meta.low_mm[2], meta.high_mm[2]) },
      reliefs: { value: meta.relief_range_um / meta.units[2] },
      contours: { value: 0 },
      turn: { value: new Matrix2().set(a, b, c, d) },
      scale: { value: scaleTexture("height") },
      picture: { value: blank },
    },
    userData: { height: scaleTexture("height"), relief: scaleTexture("relief"), blank },
  });
}

/** Direction towards the lamp: azimuth counter-clockwise from the right, both in degrees. */
export function lampDirection(azimuth, elevation) {
  const a = (azimuth * Math.PI) / 180;
  const e = (elevation * Math.PI) / 180;
  return new Vector3(Math.cos(a) * Math.cos(e), Math.sin(a) * Math.cos(e), Math.sin(e));
}

export const MARK_COLOURS = { a: new Color(0x0a5ea8), b: new Color(0xb8400a) };
