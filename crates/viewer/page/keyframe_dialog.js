// A keyframe: where it is, what it could be taken for, and the image that it was made of, where the map keeps it.
import * as THREE from "three";

const byId = (id) => document.getElementById(id);

// A click so near to a keyframe is meant for it, pixels.
const NEAR_PX = 12;
// A pointer that moves farther between press and release turns the view.
const STILL_PX = 4;

export class KeyframeDialog {
  constructor() {
    this.dialog = byId("keyframe");
    this.image = byId("keyframe-image");
    this.image.addEventListener("load", () => this.showImage(true));
    this.image.addEventListener("error", () => this.showImage(false));
  }

  // `map`: as in the list of maps.
  show(map, keyframe) {
    const { id, position, position_covariance: c, alias } = keyframe;
    const sigma3 = 3 * Math.sqrt(Math.max((c[0][0] + c[1][1] + c[2][2]) / 3, 0));
    byId("keyframe-title").textContent = `Keyframe ${id}`;
    byId("keyframe-figures").textContent =
      `(${position.map((value) => value.toFixed(2)).join(", ")}) m ± ${sigma3.toFixed(2)} m (3σ).`;
    byId("keyframe-alias").textContent = alias
      ? `The place that it could be taken for most easily is that of keyframe ${alias.keyframe}, with odds of ${oddsText(alias.log_odds)}.`
      : "";
    this.image.hidden = true;
    this.image.removeAttribute("src");
    byId("keyframe-no-image").textContent = map.keyframe_images ? "" : "This map keeps no images of its keyframes.";
    if (map.keyframe_images) {
      this.image.alt = `What keyframe ${id} saw`;
      this.image.src = `api/maps/${encodeURIComponent(map.name)}/keyframes/${id}/image`;
    }
    if (!this.dialog.open) this.dialog.showModal();
  }

  showImage(isThere) {
    if (!this.image.hasAttribute("src")) return;
    this.image.hidden = !isThere;
    byId("keyframe-no-image").textContent = isThere ? "" : "No image of this keyframe is kept.";
  }
}

function oddsText(log_odds) {
  const odds = Math.exp(log_odds);
  return odds >= 1 ? `${odds.toPrecision(2)} to 1` : `1 to ${(1 / odds).toPrecision(2)}`;
}

// Where a point of G is drawn, null for one behind the camera.
export function pixelOf(scene, position) {
  const { x, y, z } = scene.world.localToWorld(new THREE.Vector3(...position)).project(scene.camera);
  return Math.abs(z) > 1 ? null : [((x + 1) * window.innerWidth) / 2, ((1 - y) * window.innerHeight) / 2];
}

// Calls `onPicked` with the keyframe that is clicked at. `keyframes()`: those that are drawn.
export function pickKeyframes(scene, canvas, keyframes, onPicked) {
  let pressed = null;
  canvas.addEventListener("pointerdown", ({ clientX, clientY }) => (pressed = [clientX, clientY]));
  canvas.addEventListener("click", ({ clientX, clientY }) => {
    if (!pressed || Math.hypot(clientX - pressed[0], clientY - pressed[1]) > STILL_PX) return;
    let [nearest, least] = [null, NEAR_PX];
    for (const keyframe of keyframes()) {
      const pixel = pixelOf(scene, keyframe.position);
      const distance = pixel ? Math.hypot(pixel[0] - clientX, pixel[1] - clientY) : Infinity;
      if (distance < least) [nearest, least] = [keyframe, distance];
    }
    if (nearest) onPicked(nearest);
  });
}
