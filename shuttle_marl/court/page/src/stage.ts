// Renders a rally at a given time.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { clone } from "three/addons/utils/SkeletonUtils.js";
import { Athlete, type Kit } from "./athlete";
import { around, Framing, mixed, type Picture } from "./framing";
import { at, Backdrop, BEHIND, buildHall, DARK, facing, simplify } from "./hall";
import type { Motion } from "./motion";
import { placeOf } from "./recover";
import { type Flight, Marks, Shuttle } from "./shuttle";
import type { HallFacts, RallyFacts, Stroke, StrokeValue, Vec3 } from "./wire.gen";

export const CAMERAS = ["broadcast", "side", "corner", "follow", "top", "free", "director"] as const;
export type Camera = (typeof CAMERAS)[number];
/** What is seen; the director chooses between the others. */
type Shot = Exclude<Camera, "director">;

export const COLOURS: [string, string] = ["#38bdf8", "#fb7185"];
const KITS: [Kit, Kit] = [
  { skin: 0xd9a07a, hair: 0x1c1410, shirt: 0x0b4fd6, shorts: 0x0b1020, racket: 0x38bdf8 },
  { skin: 0xb97d58, hair: 0x120c0a, shirt: 0xc1122f, shorts: 0x14141c, racket: 0xfb7185 },
];

const TOUCHED = matchMedia("(pointer: coarse)");
const BLEND = 180; // [ms]
const CLICK = 5; // maximum pointer movement of a click [px]
const LATE = 80; // frame time above which software rendering lowers the resolution [ms]
const ATTACKS = new Set(["smash", "half-smash", "net-kill"]);
const BEFORE = 0.5; // time before an attack at which the director shows the side [s]
const WIDE = 1.5; // shape of a window from which on the side is shown
const ACROSS = 1.2; // shape of a window that holds the width of the court
const TURNING = 600; // time in which the picture follows another motion [ms]
const LANDED = 2.1; // time for which the landing point is marked [s]
const OFFERED = new THREE.Color(0xe6edf7); // of areas that may be chosen
const OPEN = new THREE.Color(0xf97316); // of the open side
const HIGHEST = 1.7; // height up to which the picture of a person who plays holds everything: it stands still under a lift [m]
const FEWER = 0.6; // the lower resolution, as a fraction of the page resolution

/** Where a camera stands and looks, and the distance behind which it sees: stands and boards in front of it are left out. */
interface View {
  eye: THREE.Vector3;
  look: THREE.Vector3;
  from: number;
}

/** Left, top, right, bottom. */
type Box = [number, number, number, number];

/** Whether WebGL renders in software; tested on a separate canvas, because antialiasing is fixed when a context is created. */
function isSlow(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl?.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

export class Stage {
  readonly canvas: HTMLCanvasElement;
  readonly lite: boolean;
  camera: Camera = "broadcast";
  flipped = false;
  /** Whether a person plays: the camera stands higher and holds the whole court, so that they can point at it. */
  raised = false;
  /** Whether the last pointer gesture was a drag. */
  dragged = false;
  /** What the last frame shows, and its target area; null before the first. */
  shot: Shot | null = null;
  targetArea: Box | null = null;
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly backdrop: Backdrop;
  private readonly eye = new THREE.PerspectiveCamera(40, 1, 0.1, 120);
  private readonly controls: OrbitControls;
  private readonly shuttle: Shuttle;
  private readonly marks = new Marks();
  private readonly colours = COLOURS.map((colour) => new THREE.Color(colour)) as [THREE.Color, THREE.Color];
  private readonly models = new Map<string, THREE.Object3D>();
  private athletes: [Athlete, Athlete] | null = null;
  private shades: THREE.Mesh[] = [];
  private cast = "";
  private framing: { key: string; motion: Motion; of: Framing } | null = null;
  private picture: Picture = [-1, 1, -0.5, 0.5];
  private turning: { from: Picture; began: number } | null = null;
  private blend: { motion: Motion; time: number; began: number } | null = null;
  private drawn = 0; // time of the last frame
  private late = 0; // consecutive slow frames

  constructor(
    private readonly facts: HallFacts,
    private readonly load: (athlete: string) => Promise<ArrayBuffer>,
    quality: "auto" | "full" | "lite",
    private readonly still: boolean,
    private readonly nameOnShirt: (identifier: string) => string,
  ) {
    this.canvas = document.createElement("canvas");
    this.lite = quality === "lite" || (quality === "auto" && isSlow());
    const context = this.canvas.getContext("webgl2", {
      antialias: !this.lite,
      preserveDrawingBuffer: true,
      powerPreference: "high-performance",
    });
    if (!context) {
      throw new Error("this browser does not support WebGL 2; the rally is described as text");
    }
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, context });
    this.eye.layers.enable(BEHIND);
    this.backdrop = new Backdrop(this.renderer);
    this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
    this.renderer.toneMappingExposure = 1.08;
    this.renderer.setClearColor(DARK);
    this.renderer.shadowMap.enabled = !this.lite;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.setPixelRatio(this.lite ? 1 : Math.min(window.devicePixelRatio, 2));
    buildHall(this.scene, facts, this.lite);
    this.shuttle = new Shuttle(facts.shuttle);
    this.scene.add(
      this.shuttle.root,
      this.shuttle.trail,
      this.shuttle.shade,
      this.marks.area.root,
      this.marks.open.root,
      this.marks.landing,
      this.marks.flight,
      this.marks.waits,
      ...this.marks.legal.map(({ root }) => root),
    );
    this.controls = new OrbitControls(this.eye, this.canvas);
    this.controls.enabled = false;
    this.controls.maxPolarAngle = 0.495 * Math.PI;
    this.controls.minDistance = 2;
    this.controls.maxDistance = 22;
    this.watchPointer();
    if (this.lite) {
      this.shades = [0, 1].map(() => {
        const shade = new THREE.Mesh(
          new THREE.CircleGeometry(0.42, 24).rotateX(-Math.PI / 2),
          new THREE.MeshBasicMaterial({ color: 0, transparent: true, opacity: 0.38, depthWrite: false }),
        );
        this.scene.add(shade);
        return shade;
      });
    }
  }

  /** Orbit controls: drag and wheel turn the view; a click aims. */
  private watchPointer(): void {
    const { canvas } = this;
    let from: [number, number] | null = null;
    canvas.addEventListener("pointerdown", ({ clientX, clientY }) => {
      from = [clientX, clientY];
      this.dragged = false;
    });
    canvas.addEventListener("pointermove", ({ buttons, clientX, clientY }) => {
      if (buttons && from && this.controls.enabled && Math.hypot(clientX - from[0], clientY - from[1]) > CLICK) {
        this.dragged = true;
        this.camera = "free";
      }
    });
    canvas.addEventListener("wheel", () => (this.camera = "free"), { passive: true });
  }

  /** Loads the athletes of a rally; await it before the rally is drawn. */
  async prepare(rally: RallyFacts): Promise<void> {
    const cast = JSON.stringify([rally.players, rally.names]);
    if (cast === this.cast) {
      return;
    }
    for (const name of new Set(rally.players.map((player) => player.athlete))) {
      if (!this.models.has(name)) {
        const loaded = await new GLTFLoader().parseAsync(await this.load(name), "");
        this.models.set(name, loaded.scene);
        if (this.lite) {
          simplify(loaded.scene);
        }
      }
    }
    for (const old of this.athletes ?? []) {
      this.scene.remove(old.root);
    }
    const made = rally.players.map(({ athlete, hand }, seat) => {
      const me = this.facts.athletes[athlete]![hand]!;
      return new Athlete(clone(this.models.get(athlete)!), this.facts, me, KITS[seat]!, this.nameOnShirt(rally.names[seat]!));
    });
    this.athletes = made as [Athlete, Athlete];
    this.scene.add(...made.map((one) => one.root));
    this.cast = cast;
  }

  resize(width: number, height: number): void {
    this.renderer.setSize(width, height, false);
    this.eye.aspect = width / height;
  }

  /** Blends from the poses of another motion for a short time. */
  blendFrom(motion: Motion, time: number): void {
    this.blend = { motion, time, began: performance.now() };
  }

  /**
   * Draws a rally at a time [s].
   * @param target replaces the target area of the stroke unless it is null.
   * @param legal areas that may be chosen.
   * @param flight flight that is sketched; null: none.
   * @param waiting the stroke whose positions and open side are shown; null: none are.
   * @param paused whether the whole flight of the shuttle is drawn.
   */
  draw(
    rally: RallyFacts,
    motion: Motion,
    time: number,
    target: Box | null,
    legal: Box[],
    flight: Flight | null,
    waiting: StrokeValue | null,
    paused: boolean,
  ): void {
    if (!this.athletes) {
      return;
    }
    const share = this.blend ? (performance.now() - this.blend.began) / BLEND : 1;
    if (share >= 1) {
      this.blend = null;
    }
    this.aimAt(rally, motion, time);
    this.athletes.forEach((athlete, seat) => {
      athlete.pose(motion, time, seat);
      if (this.blend) {
        athlete.moveFrom(this.blend.motion, this.blend.time, seat, share);
      }
    });
    const hips: Vec3 = [0, 0, 0];
    this.shades.forEach((shade, seat) => {
      motion.hipsAt(time, seat, hips);
      shade.position.copy(at(hips[0], hips[1], 0.005));
    });
    const current = rally.strokes.findLastIndex((stroke) => stroke.time <= time + 1e-6);
    const stroke = rally.strokes[current];
    const flying = stroke !== undefined && time < stroke.end_time + 0.25;
    const colour = this.colours[stroke?.seat ?? 0]!;
    const pixels = this.canvas.height / this.renderer.getPixelRatio() / (this.picture[3] - this.picture[2]);
    this.shuttle.show(motion, time, flying ? stroke : null, paused, colour, this.eye.position, pixels);
    this.targetArea = target ?? (flying ? stroke.box : null);
    this.marks.showFlight(flight);
    this.marks.showLegal(legal, OFFERED);
    this.marks.area.show(this.targetArea, target ? new THREE.Color("#fbbf24") : colour);
    const receiver = 1 - (stroke?.seat ?? 0);
    const place = (position: number) => placeOf(this.facts, rally, receiver, position);
    const seen = flying ? waiting : null;
    const stood = seen && stroke!.waited !== null ? motion.hipsAt(stroke!.time, receiver, [0, 0, 0]) : null;
    const perfect = (seen?.places ?? []).map((one): Vec3 => [...place(one.position), one.perfect]);
    this.marks.showWaits(stood && [stood[0], stood[1]], perfect, this.colours[receiver]!);
    this.marks.open.show(seen?.open?.box ?? null, OPEN);
    const last = rally.strokes.at(-1);
    const over = last !== undefined && rally.winner !== null && time >= last.end_time;
    this.marks.showLanding(over && time < last.end_time + LANDED ? last.end_point : null, last?.end === "winner");
    if (this.lite) {
      this.easeOff(paused); // before the picture, which a new resolution clears
    }
    // Software rendering draws the static background once per view.
    if (this.lite && this.framing && this.shot !== "free" && this.shot !== "follow") {
      const whole = this.framing.of.whole(this.eye.aspect);
      this.backdrop.render(
        this.scene,
        this.eye,
        () => this.look(whole),
        () => this.look(this.picture),
        inside(this.picture, whole),
      );
    } else {
      this.renderer.render(this.scene, this.eye);
    }
  }

  /** Lowers the resolution after several slow frames; while paused, frames come when the viewer steps. */
  private easeOff(paused: boolean): void {
    const now = performance.now();
    const since = now - this.drawn;
    this.drawn = now;
    this.late = !paused && since > LATE && since < 2000 ? this.late + 1 : 0;
    if (this.late === 8) {
      this.renderer.setPixelRatio(FEWER);
    }
  }

  private aimAt(rally: RallyFacts, motion: Motion, time: number): void {
    const { eye, controls } = this;
    const camera = this.camera === "director" ? directed(rally, time, eye.aspect) : this.camera;
    const changed = this.shot !== camera;
    this.shot = camera;
    // Touch scrolls the page unless it turns the view.
    controls.enabled = this.camera === "free" || !TOUCHED.matches;
    this.canvas.style.touchAction = controls.enabled ? "none" : "pan-y";
    if (camera === "free") {
      if (changed) {
        eye.up.copy(THREE.Object3D.DEFAULT_UP);
        eye.fov = 34;
        eye.near = 0.1;
      }
      eye.updateProjectionMatrix();
      controls.update();
      return;
    }
    // From above, the court lies across a wide window.
    eye.up.copy(camera === "top" && eye.aspect > ACROSS ? at(this.flipped ? -1 : 1, 0, 0) : THREE.Object3D.DEFAULT_UP);
    const view = this.view(camera, rally, motion, time);
    eye.position.copy(view.eye);
    controls.target.copy(view.look);
    eye.lookAt(view.look);
    eye.updateMatrixWorld();
    eye.near = view.from;
    this.picture = camera === "follow" ? around(0, 0, 1, eye.aspect) : this.framed(camera, motion, time);
    this.look(this.picture);
  }

  /** The picture of a camera that stands still; it follows another motion from where it was. */
  private framed(camera: Shot, motion: Motion, time: number): Picture {
    const { aspect, matrixWorldInverse } = this.eye;
    const key = [camera, this.flipped, this.raised, aspect > ACROSS].join();
    if (this.framing?.key !== key || this.framing.motion !== motion) {
      const follows = this.framing?.key === key && !this.still && !this.lite;
      this.turning = follows ? { from: this.picture, began: performance.now() } : null;
      const always = this.always(camera);
      const seen = (time: number) => [...this.seen(motion, time), ...always];
      this.framing = { key, motion, of: new Framing(motion.duration, seen, matrixWorldInverse) };
    }
    const wanted = this.framing.of.at(time, aspect);
    const share = this.turning ? (performance.now() - this.turning.began) / TURNING : 1;
    return share < 1 ? mixed(this.turning!.from, wanted, share * share * (3 - 2 * share)) : wanted;
  }

  /** What a picture holds at every time: the court, for who points at it; else the middle of it, so that the lens often rests. */
  private always(camera: Shot): THREE.Vector3[] {
    const { half_width: x, half_length: y } = this.facts.court;
    if (this.raised) {
      return [at(-x, -y, 0), at(x, -y, 0), at(-x, y, 0), at(x, y, 0), at(0, y, HIGHEST)];
    }
    if (camera !== "broadcast") {
      return [];
    }
    const [end, aside] = [this.flipped ? -1 : 1, this.eye.aspect > ACROSS ? x : 0];
    return [at(-aside, -end * y * 0.5, 0), at(aside, -end * y * 0.5, 0), at(0, end * y * 0.6, 2.8)];
  }

  /** What a picture holds at a time: bodies, rackets and the shuttle. Poses the athletes. */
  private seen(motion: Motion, time: number): THREE.Vector3[] {
    const players = this.athletes!.flatMap((athlete, seat) => {
      athlete.pose(motion, time, seat);
      return [...athlete.body(), athlete.strings()];
    });
    // Between two moments, the shuttle may turn at a racket.
    const shuttle = [-0.02, 0, 0.02].map((step) => at(...motion.shuttleAt(time + step, [0, 0, 0])));
    const all = [...players, ...shuttle];
    return this.raised ? all.map((point) => point.setY(Math.min(point.y, HIGHEST))) : all;
  }

  /** Sets the lens to a picture. */
  private look([left, right, bottom, top]: Picture): void {
    const { near, far } = this.eye;
    this.eye.projectionMatrix.makePerspective(left * near, right * near, top * near, bottom * near, near, far);
    this.eye.projectionMatrixInverse.copy(this.eye.projectionMatrix).invert();
  }

  private view(camera: Shot, rally: RallyFacts, motion: Motion, time: number): View {
    const end = this.flipped ? -1 : 1;
    switch (camera) {
      case "side":
        return { eye: at(-end * 15, 0, 4.2), look: at(0, 0, 1.2), from: 8.5 };
      case "corner":
        return { eye: at(-end * 9.5, -end * 13.5, 5), look: at(0, 0, 0.9), from: 6 };
      case "top":
        return { eye: at(0, -end * 0.01, 19), look: at(0, 0, 0), from: 5 };
      case "follow": {
        const seat = facing(rally, 0) === end ? 0 : 1; // the player at the near end
        const hips = motion.hipsAt(time, seat, [0, 0, 0]);
        return { eye: at(hips[0] * 0.85, hips[1] - end * 4.4, 2.55), look: at(hips[0] * 0.5, end * 2.5, 1.35), from: 0.1 };
      }
      default:
        if (this.raised) {
          return { eye: at(0, -end * 13, 11), look: at(0, 0, 0), from: 7 };
        }
        // In a narrow picture, which both players fill from side to side, the closer eye sees the near one larger.
        return this.eye.aspect > ACROSS
          ? { eye: at(0, -end * 16, 4), look: at(0, 0, 6), from: 7 }
          : { eye: at(0, -end * 13, 4), look: at(0, 0, 7), from: 4 };
    }
  }

  /** Where players, as the rectangles of their bodies, and the shuttle are in the picture: fractions, from the upper left. */
  held(rally: RallyFacts, motion: Motion, time: number): { players: Box[]; shuttle: [number, number] } {
    this.turning = null;
    this.aimAt(rally, motion, time);
    this.athletes?.forEach((athlete, seat) => athlete.pose(motion, time, seat));
    const shuttle = this.fractions(at(...motion.shuttleAt(time, [0, 0, 0])));
    return { players: [0, 1].map((seat) => this.body(seat)!), shuttle };
  }

  /** Where a point is in the picture. */
  private fractions(point: THREE.Vector3): [number, number] {
    const { x, y } = point.project(this.eye);
    return [(x + 1) / 2, (1 - y) / 2];
  }

  private body(seat: number): Box | null {
    const points = this.athletes?.[seat]?.body().map((point) => this.fractions(point));
    const [u, v] = [0, 1].map((k) => points?.map((point) => point[k]!) ?? []) as [number[], number[]];
    return points ? [Math.min(...u), Math.min(...v), Math.max(...u), Math.max(...v)] : null;
  }

  /** Centre of the string bed of a player, in court axes. */
  sweetSpot(seat: number): Vec3 | null {
    const v = this.athletes?.[seat]?.strings();
    return v ? [-v.x, v.z, v.y] : null;
  }

  /** Smallest rectangle of the window that contains the body of a player; null before the first. */
  outline(seat: number): Box | null {
    const found = this.body(seat);
    return found && [...this.windowOf(found[0], found[1]), ...this.windowOf(found[2], found[3])];
  }

  private windowOf(u: number, v: number): [number, number] {
    const box = this.canvas.getBoundingClientRect();
    return [box.left + u * box.width, box.top + v * box.height];
  }

  /** Point of the floor at window coordinates, or null. */
  floorAt(clientX: number, clientY: number): [number, number] | null {
    const box = this.canvas.getBoundingClientRect();
    const point = new THREE.Vector2((2 * (clientX - box.left)) / box.width - 1, 1 - (2 * (clientY - box.top)) / box.height);
    const ray = new THREE.Raycaster();
    ray.setFromCamera(point, this.eye);
    const hit = ray.ray.intersectPlane(new THREE.Plane(new THREE.Vector3(0, 1, 0), 0), new THREE.Vector3());
    return hit ? [-hit.x, hit.z] : null;
  }

  /** Window coordinates of a point of the floor. */
  windowAt(x: number, y: number): [number, number] {
    return this.windowOf(...this.fractions(at(x, y, 0)));
  }

  get figures(): { draw_calls: number; triangles: number; geometries: number; textures: number } {
    const { render, memory } = this.renderer.info;
    return { draw_calls: render.calls, triangles: render.triangles, geometries: memory.geometries, textures: memory.textures };
  }
}

/** Camera of the director: the side for an attack, if the window is wide, else that of a broadcast. */
function directed(rally: RallyFacts, time: number, aspect: number): Shot {
  const attacks = ({ shot, time: begins, end_time }: Stroke) => ATTACKS.has(shot) && time >= begins - BEFORE && time < end_time;
  return aspect >= WIDE && rally.strokes.some(attacks) ? "side" : "broadcast";
}

/** A picture as a part of another: its corner and its size, as fractions. */
function inside([left, right, bottom, top]: Picture, [l, r, b, t]: Picture): [number, number, number, number] {
  return [(left - l) / (r - l), (bottom - b) / (t - b), (right - left) / (r - l), (top - bottom) / (t - b)];
}
