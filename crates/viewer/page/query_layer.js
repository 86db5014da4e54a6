// The candidates of a query in the map: solid lines to the keyframes of the answer, dashed ones to those refused.
import * as THREE from "three";
import { frustumEnds } from "./map_layer.js";
import { styleColor } from "./colors.js";

const DASH_M = 0.2;

function lines(parent, material) {
  const line = new THREE.LineSegments(new THREE.BufferGeometry(), material);
  line.frustumCulled = false;
  line.visible = false;
  parent.add(line);
  return line;
}

function setEnds(line, ends) {
  line.geometry.dispose();
  line.geometry = new THREE.BufferGeometry();
  line.geometry.setAttribute("position", new THREE.BufferAttribute(ends, 3));
  line.visible = ends.length > 0;
  if (line.material.isLineDashedMaterial) line.computeLineDistances();
}

export class QueryLayer {
  constructor(scene) {
    const dashed = () => new THREE.LineDashedMaterial({ dashSize: DASH_M, gapSize: DASH_M, depthTest: false });
    const solid = () => new THREE.LineBasicMaterial({ depthTest: false });
    this.parts = [true, false].map((isUsed) => ({
      isUsed,
      rays: lines(scene.world, isUsed ? solid() : dashed()),
      frusta: lines(scene.world, solid()),
    }));
    this.applyTheme();
  }

  applyTheme() {
    for (const { isUsed, rays, frusta } of this.parts) {
      const color = styleColor(isUsed ? "--localized" : "--lost");
      rays.material.color.set(color);
      frusta.material.color.set(color);
    }
  }

  // `from`: the camera in G, null where it is not known; `candidates`: pairs of a keyframe and whether it is in the answer.
  set(from, candidates, size) {
    for (const { isUsed, rays, frusta } of this.parts) {
      const keyframes = candidates.filter((candidate) => candidate.isUsed === isUsed).map(({ keyframe }) => keyframe);
      const ends = from ? keyframes.flatMap(({ position }) => [...from, ...position]) : [];
      setEnds(rays, new Float32Array(ends));
      setEnds(frusta, frustumEnds(keyframes, 1.3 * size));
    }
  }
}
