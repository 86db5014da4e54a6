// The candidates of a query in the map: solid lines to the keyframes of the answer, dashed ones to those refused.
import * as THREE from "three";
import { ellipsoid, frustumEnds } from "./map_layer.js";
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
    this.camera = lines(scene.world, solid());
    const shell = new THREE.MeshLambertMaterial({ transparent: true, opacity: 0.45, depthWrite: false });
    this.cloud = new THREE.Mesh(new THREE.SphereGeometry(1, 24, 16), shell);
    this.cloud.matrixAutoUpdate = false;
    this.cloud.visible = false;
    scene.world.add(this.cloud);
    this.applyTheme();
  }

  applyTheme() {
    for (const { material } of [this.camera, this.cloud]) material.color.set(styleColor("--accent"));
    for (const { isUsed, rays, frusta } of this.parts) {
      const color = styleColor(isUsed ? "--localized" : "--lost");
      rays.material.color.set(color);
      frusta.material.color.set(color);
    }
  }

  // `from`: the camera in G, null where it is not known; `candidates`: pairs of a keyframe and whether it is in the answer; `fix`: the
  // pose that was estimated, or null.
  set(from, candidates, size, fix) {
    setEnds(this.camera, frustumEnds(fix ? [fix] : [], 2 * size));
    this.cloud.visible = Boolean(fix);
    if (fix) {
      this.cloud.matrix.copy(ellipsoid(fix.position_covariance, fix.position));
      this.cloud.matrixWorldNeedsUpdate = true;
    }
    for (const { isUsed, rays, frusta } of this.parts) {
      const keyframes = candidates.filter((candidate) => candidate.isUsed === isUsed).map(({ keyframe }) => keyframe);
      const ends = from ? keyframes.flatMap(({ position }) => [...from, ...position]) : [];
      setEnds(rays, new Float32Array(ends));
      setEnds(frusta, frustumEnds(keyframes, 1.3 * size));
    }
  }
}
