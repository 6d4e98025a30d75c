/** Shaders of the finger. Colours are those of the page, light is fixed to the eye: nothing has to be converted. */

export const SKIN_VERTEX = `
attribute float value;
attribute float part;
attribute vec3 rest;
varying float vValue;
varying float vPart;
varying vec3 vRest;
varying vec3 vNormal;
varying vec3 vEye;
void main() {
  vValue = value;
  vPart = part;
  vRest = rest;
  vNormal = normalMatrix * normal;
  vec4 eye = modelViewMatrix * vec4(position, 1.0);
  vEye = -eye.xyz;
  gl_Position = projectionMatrix * eye;
}`;

export const SKIN_FRAGMENT = `
uniform sampler2D ramp;
uniform float opacity;
uniform float contour;
uniform float showBone;
uniform float showNail;
uniform float dim;
uniform vec3 ambient;
varying float vValue;
varying float vPart;
varying vec3 vRest;
varying vec3 vNormal;
varying vec3 vEye;
void main() {
  vec3 n = normalize(vNormal);
  vec3 eye = normalize(vEye);
  if (dot(n, eye) < 0.0) n = -n;
  vec3 base = texture2D(ramp, vec2(clamp(vValue, 0.002, 0.998), 0.5)).rgb;
  float gloss = 0.16;
  if (contour > 0.0) {
    float width = max(fwidth(vValue), 1e-5) * 1.1;
    float line = 1.0 - smoothstep(0.5 * width, 1.5 * width, abs(vValue - contour));
    base = mix(base, vec3(0.12, 0.05, 0.1), 0.85 * line);
  }
  if (showNail > 0.5 && vPart > 1.5) {
    base = mix(base, vec3(1.0, 0.9, 0.88), 0.55);
    gloss = 0.55;
  }
  if (showBone > 0.5 && vPart > 0.5 && vPart < 1.5) {
    float stripe = fract((vRest.x + vRest.y + vRest.z) * 620.0);
    float width = fwidth((vRest.x + vRest.y + vRest.z) * 620.0);
    float hatch = smoothstep(0.62 - width, 0.62 + width, stripe);
    base = mix(mix(base, vec3(0.93, 0.92, 0.88), 0.75), vec3(0.38, 0.44, 0.52), 0.8 * hatch);
  }
  vec3 key = normalize(vec3(-0.35, 0.85, 0.55));
  vec3 fill = normalize(vec3(0.85, 0.15, 0.5));
  float wrap = 0.5 + 0.5 * dot(n, key);
  float light = 0.4 + 0.46 * wrap * sqrt(wrap) + 0.13 * max(dot(n, fill), 0.0) + 0.08 * max(-n.y, 0.0);
  vec3 h = normalize(key + eye);
  float shine = gloss * pow(max(dot(n, h), 0.0), 42.0);
  float rim = pow(1.0 - max(dot(n, eye), 0.0), 4.0);
  vec3 shown = base * mix(vec3(1.0), ambient, 0.35) * light + shine + rim * 0.16 * ambient;
  float grey = dot(shown, vec3(0.3, 0.59, 0.11));
  gl_FragColor = vec4(mix(shown, vec3(grey), dim), opacity + (1.0 - opacity) * 0.35 * rim);
}`;

export const SHADOW_VERTEX = `
uniform vec3 origin;
uniform vec3 up;
varying float vHeight;
void main() {
  float height = dot(position - origin, up);
  vHeight = height;
  vec3 onto = position - up * (height - 2e-5);
  gl_Position = projectionMatrix * modelViewMatrix * vec4(onto, 1.0);
}`;

/** The darker one of overlapping faces is kept, by the blending of the material. */
export const SHADOW_FRAGMENT = `
uniform vec3 ground;
uniform float strength;
varying float vHeight;
void main() {
  float shade = strength * exp(-max(vHeight, 0.0) / 0.012);
  gl_FragColor = vec4(ground * (1.0 - shade), 1.0);
}`;

export const GRID_VERTEX = `
uniform vec2 shift;
varying vec2 vPlace;
varying vec2 vLocal;
void main() {
  vLocal = position.xy;
  vPlace = position.xy + shift;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

export const GRID_FRAGMENT = `
uniform vec3 line;
uniform vec3 ground;
uniform float radius;
varying vec2 vPlace;
varying vec2 vLocal;
float grid(vec2 place, float width) {
  vec2 slope = max(fwidth(place), vec2(1e-6));
  vec2 near = abs(fract(place - 0.5) - 0.5) / slope;
  vec2 faint = 1.0 - smoothstep(vec2(0.2), vec2(0.7), slope);
  vec2 drawn = (1.0 - smoothstep(vec2(width - 0.5), vec2(width + 0.5), near)) * faint;
  return max(drawn.x, drawn.y);
}
void main() {
  float far = length(vLocal) / radius;
  float fade = 1.0 - smoothstep(0.35, 1.0, far);
  float fine = grid(vPlace * 1000.0, 0.5) * 0.16;
  float coarse = grid(vPlace * 100.0, 0.8) * 0.6;
  float amount = max(fine, coarse);
  gl_FragColor = vec4(mix(ground, line, amount), (0.1 + 0.9 * amount) * fade);
}`;
