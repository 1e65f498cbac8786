// The shuttle, the trail behind it, and the marks on the floor.

import * as THREE from "three";
import { at, joined } from "./hall";
import type { Motion } from "./motion";
import type { HallFacts, Stroke, Vec3 } from "./wire.gen";

const TRAIL = 0.42; // [s]
const SMASH_TRAIL = 0.8; // of fast strokes [s]
const FAST = 45; // [m/s]
const WIDTH = 0.075; // half width of the trail [m]
const SMALLEST = 6; // diameter of the shuttle on the screen [px]
const DIAMETER = 0.065; // [m]
const POINTS = 48;
const FORWARD = new THREE.Vector3(0, 1, 0);

export class Shuttle {
  readonly root = new THREE.Group();
  readonly trail: THREE.Mesh;
  readonly shade: THREE.Mesh;
  private readonly position: THREE.BufferAttribute;
  private readonly colours: THREE.BufferAttribute;
  private readonly scale: number;
  private readonly place: Vec3 = [0, 0, 0];
  private readonly way: Vec3 = [0, 0, 0];

  constructor({
    scale,
    cork: radius,
    feathers: count,
    feather: [[near, narrow, ahead], [far, wide, behind]],
  }: HallFacts["shuttle"]) {
    this.scale = scale;
    // The cork points along y; the origin lies in the cork.
    const cork = new THREE.Mesh(
      joined([
        new THREE.SphereGeometry(radius, 14, 10),
        new THREE.CylinderGeometry(radius, radius, 0.012, 14).translate(0, -0.007, 0),
      ]),
      new THREE.MeshStandardMaterial({ color: 0xf3ecd9, roughness: 0.6 }),
    );
    const feathers: THREE.BufferGeometry[] = [];
    const length = Math.hypot(far - near, behind - ahead);
    for (let i = 0; i < count; i++) {
      const vane = new THREE.PlaneGeometry(2 * wide, length, 1, 1).translate(0, -length / 2, 0);
      const p = vane.getAttribute("position");
      for (let k = 0; k < p.count; k++) {
        if (p.getY(k) > -0.01) {
          p.setX(k, (narrow / wide) * p.getX(k));
        }
      }
      feathers.push(
        vane
          .rotateX(Math.atan2(far - near, behind - ahead))
          .translate(0, -ahead, near)
          .rotateY((2 * i * Math.PI) / count),
      );
    }
    const skirt = new THREE.Mesh(
      joined(feathers),
      new THREE.MeshStandardMaterial({ color: 0xffffff, roughness: 0.9, side: THREE.DoubleSide, emissive: 0x6a6a6a }),
    );
    cork.castShadow = skirt.castShadow = true;
    this.root.add(cork, skirt);
    this.shade = new THREE.Mesh(
      new THREE.CircleGeometry(0.075, 20).rotateX(-Math.PI / 2),
      new THREE.MeshBasicMaterial({ color: 0x000000, transparent: true, opacity: 0.5, depthWrite: false }),
    );
    const geometry = new THREE.BufferGeometry();
    this.position = new THREE.BufferAttribute(new Float32Array(POINTS * 6), 3);
    this.colours = new THREE.BufferAttribute(new Float32Array(POINTS * 8), 4);
    geometry.setAttribute("position", this.position);
    geometry.setAttribute("color", this.colours);
    const order: number[] = [];
    for (let i = 0; i < POINTS - 1; i++) {
      order.push(2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 1, 2 * i + 3, 2 * i + 2);
    }
    geometry.setIndex(order);
    this.trail = new THREE.Mesh(
      geometry,
      new THREE.MeshBasicMaterial({
        vertexColors: true,
        transparent: true,
        depthWrite: false,
        side: THREE.DoubleSide,
        blending: THREE.AdditiveBlending,
        fog: false,
      }),
    );
    this.trail.frustumCulled = false;
  }

  /**
   * Moves to the position at a time.
   * @param flight the last stroke, along which the trail is drawn; null: the shuttle rests. When paused, the whole flight is drawn.
   * @param pixels size of one metre at a distance of one metre on the screen [px].
   */
  show(
    motion: Motion,
    time: number,
    flight: Stroke | null,
    paused: boolean,
    colour: THREE.Color,
    eye: THREE.Vector3,
    pixels: number,
  ): void {
    this.root.position.copy(at(...motion.shuttleAt(time, this.place)));
    const size = (pixels * DIAMETER) / Math.max(0.1, this.root.position.distanceTo(eye));
    this.root.scale.setScalar(this.scale * Math.max(1, SMALLEST / size));
    const heading = at(...motion.headingAt(time, this.way)).normalize();
    this.root.quaternion.setFromUnitVectors(FORWARD, heading);
    this.shade.position.set(this.root.position.x, 0.006, this.root.position.z);
    const height = this.root.position.y;
    this.shade.scale.setScalar(1 + 0.12 * height);
    (this.shade.material as THREE.MeshBasicMaterial).opacity = 0.55 / (1 + 0.35 * height);
    this.trail.visible = flight !== null;
    if (flight) {
      const lasts = paused ? Infinity : flight.speed >= FAST ? SMASH_TRAIL : TRAIL;
      const end = paused ? Math.max(time, flight.end_time) : time;
      this.drawTrail(motion, end, Math.max(flight.time, time - lasts), colour, eye, paused);
    }
  }

  private drawTrail(
    motion: Motion,
    time: number,
    start: number,
    colour: THREE.Color,
    eye: THREE.Vector3,
    whole: boolean,
  ): void {
    const point: Vec3 = [0, 0, 0];
    const here = new THREE.Vector3();
    const before = new THREE.Vector3();
    const along = new THREE.Vector3();
    const aside = new THREE.Vector3();
    for (let i = 0; i < POINTS; i++) {
      const u = i / (POINTS - 1);
      here.copy(at(...motion.shuttleAt(start + u * (time - start), point)));
      before.copy(at(...motion.shuttleAt(start + u * (time - start) - 0.004, point)));
      along.subVectors(here, before);
      aside
        .crossVectors(along, before.subVectors(eye, here))
        .normalize()
        .multiplyScalar(WIDTH * (whole ? 0.4 : 0.12 + 0.88 * u));
      this.position.setXYZ(2 * i, here.x + aside.x, here.y + aside.y, here.z + aside.z);
      this.position.setXYZ(2 * i + 1, here.x - aside.x, here.y - aside.y, here.z - aside.z);
      for (const k of [2 * i, 2 * i + 1]) {
        this.colours.setXYZW(k, colour.r, colour.g, colour.b, whole ? 0.5 : 0.75 * u * u);
      }
    }
    this.position.needsUpdate = this.colours.needsUpdate = true;
  }
}

/** A stroke that is pointed at: its contact [m], target area and shot. */
export interface Flight {
  from: Vec3;
  box: [number, number, number, number];
  shot: string;
}

/** Height by which the sketch of a flight rises above the straight line [m]. */
const RISE: Record<string, number> = { clear: 3.2, lift: 4.2, "long-serve": 4.5, drop: 0.5, drive: 0.25, push: 0.6 };
const OVER_NET = 1.65; // smallest height of a sketch above the net [m]
const SKETCH = 32;

/** Points of the sketch of a flight: a parabola over the net to the middle of the target. */
function sketch({ from: [x, y, z], box: [x0, x1, y0, y1], shot }: Flight): THREE.Vector3[] {
  const [tx, ty] = [(x0 + x1) / 2, (y0 + y1) / 2];
  const net = y / (y - ty);
  const needed = (OVER_NET - (1 - net) * z) / (4 * net * (1 - net));
  const rise = Math.max(RISE[shot] ?? 0, needed, 0);
  return Array.from({ length: SKETCH }, (_, i) => {
    const t = i / (SKETCH - 1);
    return at(x + t * (tx - x), y + t * (ty - y), Math.max(0.02, (1 - t) * z + 4 * rise * t * (1 - t)));
  });
}

const DOT = 0.5; // radius of the dot of a position that perfect play always chooses [m]
const FAINT = 0.02; // probability below which a position has no dot
const POSITIONS = 9;

/** A rectangle on the floor. */
class Area {
  readonly root: THREE.Group;
  private readonly fill: THREE.Mesh<THREE.PlaneGeometry, THREE.MeshBasicMaterial>;
  private readonly edge: THREE.LineLoop<THREE.BufferGeometry, THREE.LineBasicMaterial>;

  constructor(opacity: number) {
    this.fill = new THREE.Mesh(
      new THREE.PlaneGeometry(1, 1).rotateX(-Math.PI / 2),
      new THREE.MeshBasicMaterial({ transparent: true, opacity, depthWrite: false }),
    );
    const corners = [-0.5, 0, -0.5, 0.5, 0, -0.5, 0.5, 0, 0.5, -0.5, 0, 0.5];
    const outline = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
    this.edge = new THREE.LineLoop(outline, new THREE.LineBasicMaterial({ transparent: true, opacity: 0.9 }));
    this.root = new THREE.Group().add(this.fill, this.edge);
  }

  /** Shows an area `[x0, x1, y0, y1]` of the court, or none. */
  show(box: [number, number, number, number] | null, colour: THREE.Color): void {
    this.root.visible = box !== null;
    if (box) {
      const [x0, x1, y0, y1] = box;
      this.root.position.copy(at((x0 + x1) / 2, (y0 + y1) / 2, 0.01));
      this.root.scale.set(x1 - x0, 1, y1 - y0);
      this.fill.material.color.copy(colour);
      this.edge.material.color.copy(colour);
    }
  }
}

/** Markers of the target area of a stroke, of the positions of its receiver, and of the point where a rally ended. */
export class Marks {
  readonly area = new Area(0.25);
  /** Areas at which a person may aim. */
  readonly legal = Array.from({ length: POSITIONS }, () => new Area(0.1));
  /** What the position of the receiver leaves open. */
  readonly open = new Area(0.16);
  readonly landing: THREE.Mesh;
  readonly flight = new THREE.Line(
    new THREE.BufferGeometry(),
    new THREE.LineDashedMaterial({ color: 0xfbbf24, dashSize: 0.25, gapSize: 0.15, fog: false }),
  );
  /** A ring where the receiver waits, and dots where perfect play does; their areas are its probabilities. */
  readonly waits = new THREE.Group();
  private readonly ring: THREE.Mesh<THREE.RingGeometry, THREE.MeshBasicMaterial>;

  constructor() {
    this.landing = new THREE.Mesh(
      new THREE.RingGeometry(0.12, 0.17, 32).rotateX(-Math.PI / 2),
      new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.95, depthWrite: false }),
    );
    this.landing.visible = false;
    this.ring = new THREE.Mesh(
      new THREE.RingGeometry(0.5, 0.56, 48).rotateX(-Math.PI / 2),
      new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.95, depthWrite: false }),
    );
    const [disc, paint] = [
      new THREE.CircleGeometry(DOT, 40).rotateX(-Math.PI / 2),
      new THREE.MeshBasicMaterial({ color: 0xffffff, transparent: true, opacity: 0.4, depthWrite: false }),
    ];
    this.waits.add(this.ring, ...Array.from({ length: POSITIONS }, () => new THREE.Mesh(disc, paint)));
  }

  /** Shows where a receiver waits, and `[x, y, probability]` of perfect play in each position. */
  showWaits(stood: [number, number] | null, perfect: [number, number, number][], colour: THREE.Color): void {
    const [ring, ...dots] = this.waits.children as THREE.Mesh[];
    ring!.visible = stood !== null;
    if (stood) {
      ring!.position.copy(at(...stood, 0.014));
      this.ring.material.color.copy(colour);
    }
    dots.forEach((dot, i) => {
      const [x, y, share] = perfect[i] ?? [0, 0, 0];
      dot.visible = share >= FAINT;
      dot.position.copy(at(x, y, 0.013));
      dot.scale.setScalar(Math.sqrt(share) || 1);
    });
  }

  showLegal(boxes: [number, number, number, number][], colour: THREE.Color): void {
    this.legal.forEach((area, i) => area.show(boxes[i] ?? null, colour));
  }

  showFlight(flight: Flight | null): void {
    this.flight.visible = flight !== null;
    this.flight.frustumCulled = false;
    if (flight) {
      this.flight.geometry.setFromPoints(sketch(flight));
      this.flight.computeLineDistances();
    }
  }

  showLanding(place: Vec3 | null, good: boolean): void {
    this.landing.visible = place !== null;
    if (place) {
      this.landing.position.copy(at(place[0], place[1], 0.012));
      (this.landing.material as THREE.MeshBasicMaterial).color.set(good ? 0xfbbf24 : 0xf97316);
    }
  }
}
