// Renders a rally at a given time.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { clone } from "three/addons/utils/SkeletonUtils.js";
import { Athlete, type Kit } from "./athlete";
import { at, Backdrop, BEHIND, buildHall, DARK, facing, simplify } from "./hall";
import type { Motion } from "./motion";
import { placeOf } from "./recover";
import { type Flight, Marks, Shuttle } from "./shuttle";
import type { HallFacts, RallyFacts, StrokeValue, Vec3 } from "./wire.gen";

export const CAMERAS = ["broadcast", "side", "corner", "follow", "top", "free", "director"] as const;
export type Camera = (typeof CAMERAS)[number];
/** What is seen; the director chooses between the others and the winner of the rally. */
type Shot = Exclude<Camera, "director"> | "winner";

export const COLOURS: [string, string] = ["#38bdf8", "#fb7185"];
const KITS: [Kit, Kit] = [
  { skin: 0xd9a07a, hair: 0x1c1410, shirt: 0x0b4fd6, shorts: 0x0b1020, racket: 0x38bdf8 },
  { skin: 0xb97d58, hair: 0x120c0a, shirt: 0xc1122f, shorts: 0x14141c, racket: 0xfb7185 },
];

const TOUCHED = matchMedia("(pointer: coarse)");
const BLEND = 180; // [ms]
const CLICK = 5; // maximum pointer movement of a click [px]
const LATE = 80; // frame time above which software rendering lowers the resolution [ms]
const CORNERS = 0.4; // tangent of the horizontal angle of a near corner, seen from the broadcast camera
const ATTACKS = new Set(["smash", "half-smash", "net-kill"]);
const BEFORE = 0.5; // time before an attack at which the director shows the side [s]
const AFTER = 0.8; // time after the rally at which the director shows the winner [s]
const RISING = 0.7; // time that spectators take to rise after a rally [s]
const LANDED = 2.1; // time for which the landing point is marked [s]
const LONG = 20; // strokes of a rally after which all of them rise
const OPEN = new THREE.Color(0xf97316); // of the open side
const FEWER = 0.6; // the lower resolution, as a fraction of the page resolution

interface View {
  eye: THREE.Vector3;
  look: THREE.Vector3;
  fov: number;
}

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
  /** Whether the last pointer gesture was a drag. */
  dragged = false;
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly backdrop: Backdrop;
  private readonly eye = new THREE.PerspectiveCamera(40, 1, 0.1, 120);
  private readonly controls: OrbitControls;
  private readonly shuttle: Shuttle;
  private readonly marks = new Marks();
  private readonly excitement: { value: number };
  private readonly colours = COLOURS.map((colour) => new THREE.Color(colour)) as [THREE.Color, THREE.Color];
  private readonly models = new Map<string, THREE.Object3D>();
  private athletes: [Athlete, Athlete] | null = null;
  private shades: THREE.Mesh[] = [];
  private cast = "";
  private aim: View = { eye: at(0, -13, 7.5), look: at(0, 1, 0.5), fov: 36 };
  private shownCamera: Shot | null = null;
  private blend: { motion: Motion; time: number; began: number } | null = null;
  private area: [number, number, number, number] | null = null;
  private drawn = 0; // time of the last frame
  private late = 0; // consecutive slow frames
  private hurried = true; // whether slow frames lower the resolution

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
    this.excitement = buildHall(this.scene, facts, this.lite);
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
    this.eye.updateProjectionMatrix();
  }

  /** Blends from the poses of another motion for a short time. */
  blendFrom(motion: Motion, time: number): void {
    this.blend = { motion, time, began: performance.now() };
  }

  /**
   * Draws a rally at a time [s].
   * @param target replaces the target area of the stroke unless it is null.
   * @param flight flight that is sketched; null: none.
   * @param waiting the stroke whose positions and open side are shown; null: none are.
   * @param paused whether the whole flight of the shuttle is drawn.
   */
  draw(
    rally: RallyFacts,
    motion: Motion,
    time: number,
    target: [number, number, number, number] | null,
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
    this.aimAt(rally, motion, time);
    const pixels = this.canvas.height / this.renderer.getPixelRatio() / (2 * Math.tan((this.eye.fov * Math.PI) / 360));
    this.shuttle.show(motion, time, flying ? stroke : null, paused, colour, this.eye.position, pixels);
    this.area = target ?? (flying ? stroke.box : null);
    this.marks.showFlight(flight);
    this.marks.area.show(this.area, target ? new THREE.Color("#fbbf24") : colour);
    const receiver = 1 - (stroke?.seat ?? 0);
    const place = (position: number) => placeOf(this.facts, rally, receiver, position);
    const stood = flying && stroke.waited !== null ? place(stroke.waited) : null;
    const seen = flying ? waiting : null;
    const perfect = (seen?.places ?? []).map((one): Vec3 => [...place(one.position), one.perfect]);
    this.marks.showWaits(stood, perfect, this.colours[receiver]!);
    this.marks.open.show(seen?.open?.box ?? null, OPEN);
    const last = rally.strokes.at(-1);
    const over = last !== undefined && rally.winner !== null && time >= last.end_time;
    this.excitement.value = over
      ? Math.min(1, (time - last.end_time) / RISING) * Math.min(1, 0.3 + rally.strokes.length / LONG)
      : 0;
    this.marks.showLanding(over && time < last.end_time + LANDED ? last.end_point : null, last?.end === "winner");
    if (this.lite && this.hurried) {
      this.easeOff(paused); // before the picture, which a new resolution clears
    }
    // Software rendering draws the static background once per view.
    if (this.lite && this.shownCamera !== "free" && this.shownCamera !== "follow") {
      this.backdrop.render(this.scene, this.eye);
    } else {
      this.renderer.render(this.scene, this.eye);
    }
  }

  /** Whether every frame has the full resolution at one pixel per unit, so that it depends on the rally only. */
  drawWhole(on: boolean): void {
    this.hurried = !on;
    this.renderer.setPixelRatio(on || this.lite ? 1 : Math.min(window.devicePixelRatio, 2));
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
    const camera = this.camera === "director" ? directed(rally, time) : this.camera;
    const changed = this.shownCamera !== camera;
    this.shownCamera = camera;
    // Touch scrolls the page unless it turns the view.
    this.controls.enabled = this.camera === "free" || !TOUCHED.matches;
    this.canvas.style.touchAction = this.controls.enabled ? "none" : "pan-y";
    if (camera === "free") {
      this.eye.up.copy(THREE.Object3D.DEFAULT_UP);
      if (changed) {
        this.controls.target.copy(this.aim.look);
      }
      this.controls.update();
      return;
    }
    // From above, the court lies across a wide window.
    this.eye.up.copy(this.turned ? at(this.flipped ? -1 : 1, 0, 0) : THREE.Object3D.DEFAULT_UP);
    const wanted = this.view(camera, rally, motion, time);
    const share = changed || this.still || this.lite ? 1 : 0.14;
    this.aim.eye.lerp(wanted.eye, camera === "follow" ? Math.min(share, 0.2) || 1 : share);
    this.aim.look.lerp(wanted.look, share);
    this.aim.fov += share * (wanted.fov - this.aim.fov);
    this.eye.position.copy(this.aim.eye);
    this.controls.target.copy(this.aim.look);
    this.eye.fov = this.aim.fov;
    this.eye.updateProjectionMatrix();
    this.eye.lookAt(this.aim.look);
  }

  private get turned(): boolean {
    return this.camera === "top" && this.eye.aspect > 1.2;
  }

  private view(camera: Shot, rally: RallyFacts, motion: Motion, time: number): View {
    const end = this.flipped ? -1 : 1;
    // A narrow window needs a wider angle to hold the whole court.
    const wide = Math.max(1, 1.45 / this.eye.aspect);
    // The angle at which the broadcast camera sees both near corners.
    const whole = (360 / Math.PI) * Math.atan(CORNERS / this.eye.aspect);
    switch (camera) {
      case "winner": {
        const seat = rally.winner!;
        const hips = motion.hipsAt(rally.strokes.at(-1)!.end_time, seat, [0, 0, 0]);
        const net = facing(rally, seat);
        return {
          eye: at(0.8 * hips[0], hips[1] + net * 4, 1.7),
          look: at(hips[0], hips[1], 1.15),
          fov: 38 * Math.min(wide, 1.6),
        };
      }
      case "side":
        return { eye: at(-end * 10.2, 0, 2.6), look: at(0, 0, 1.25), fov: 44 * Math.min(wide, 1.6) };
      case "corner": {
        const back = 0.88 + 0.12 * Math.min(wide, 1.9); // not behind the boards of the stands
        return {
          eye: at(-end * 7.4, -end * 11, 4.3).multiplyScalar(back),
          look: at(end * 0.8, -end * 0.5, 0.9),
          fov: 40 * Math.min(wide, 1.6),
        };
      }
      case "top":
        return this.turned
          ? {
              eye: at(0, -end * 0.01, 15.5),
              look: at(0, 0, 0),
              fov: Math.max(29, (360 / Math.PI) * Math.atan(0.5 / this.eye.aspect)),
            }
          : { eye: at(0, -end * 0.01, 15.5), look: at(0, 0, 0), fov: 52 * Math.min(wide, 1.25) };
      case "follow": {
        const seat = facing(rally, 0) === end ? 0 : 1; // the player at the near end
        const hips = motion.hipsAt(time, seat, [0, 0, 0]);
        const away = -end;
        return { eye: at(hips[0] * 0.85, hips[1] + away * 4.4, 2.55), look: at(hips[0] * 0.5, -away * 2.5, 1.35), fov: 50 };
      }
      default: {
        const shuttle = motion.shuttleAt(time, [0, 0, 0]);
        const sway = rally.strokes.length && !this.lite ? 0.1 * shuttle[0] : 0;
        return { eye: at(sway, -end * 13.8, 6.7), look: at(0.4 * sway, -end * 0.5, 0.42), fov: Math.max(35.5, whole) };
      }
    }
  }

  /** Centre of the string bed of a player, in court axes. */
  sweetSpot(seat: number): Vec3 | null {
    const athlete = this.athletes?.[seat];
    if (!athlete) {
      return null;
    }
    const v = athlete.sweetSpot.getWorldPosition(new THREE.Vector3());
    return [-v.x, v.z, v.y];
  }

  /** Smallest rectangle of the window that contains the joints of a player: left, top, right, bottom; null before the first. */
  outline(seat: number): [number, number, number, number] | null {
    const athlete = this.athletes?.[seat];
    if (!athlete) {
      return null;
    }
    const box = this.canvas.getBoundingClientRect();
    const out: [number, number, number, number] = [Infinity, Infinity, -Infinity, -Infinity];
    athlete.root.traverse((part) => {
      if (part instanceof THREE.Bone) {
        const { x, y } = part.getWorldPosition(new THREE.Vector3()).project(this.eye);
        const [left, top] = [box.left + ((x + 1) / 2) * box.width, box.top + ((1 - y) / 2) * box.height];
        [out[0], out[1], out[2], out[3]] = [
          Math.min(out[0], left),
          Math.min(out[1], top),
          Math.max(out[2], left),
          Math.max(out[3], top),
        ];
      }
    });
    return out;
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

  /** What the last frame shows; null before the first. */
  get shot(): Shot | null {
    return this.shownCamera;
  }

  get targetArea(): [number, number, number, number] | null {
    return this.area;
  }

  get figures(): { draw_calls: number; triangles: number; geometries: number; textures: number } {
    const { render, memory } = this.renderer.info;
    return { draw_calls: render.calls, triangles: render.triangles, geometries: memory.geometries, textures: memory.textures };
  }
}

/** Camera of the director: the side for an attack, the winner after the rally, else that of a broadcast. */
function directed(rally: RallyFacts, time: number): Shot {
  const last = rally.strokes.at(-1);
  if (last && rally.winner !== null && time >= last.end_time + AFTER) {
    return "winner";
  }
  const attack = rally.strokes.some(
    (stroke) => ATTACKS.has(stroke.shot) && time >= stroke.time - BEFORE && time < stroke.end_time,
  );
  return attack ? "side" : "broadcast";
}
