// The hall: floor, court, net, boards, stands and lights. All static objects.

import * as THREE from "three";
import type { HallFacts, RallyFacts } from "./wire.gen";

/** Converts court axes to three.js axes. */
export function at(x: number, y: number, z: number): THREE.Vector3 {
  return new THREE.Vector3(-x, z, y);
}

/** Sign of x and y between the frame of a seat and the frame of the court; at +1 the seat is at the near end, y < 0. */
export function facing(rally: RallyFacts, seat: number): 1 | -1 {
  return (seat === 1) === rally.ends_changed ? 1 : -1;
}

/** Background colour. */
export const DARK = 0x05080f;
const FLOOR = 0x16305c;
const MAT_COLOUR = "#12785a";

/** A texture that is painted once. */
export function canvasTexture(
  width: number,
  height: number,
  paint: (g: CanvasRenderingContext2D) => void,
): THREE.CanvasTexture {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  paint(canvas.getContext("2d")!);
  const texture = new THREE.CanvasTexture(canvas);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 8;
  return texture;
}

/** Seeded random numbers. */
function* numbers(seed: number): Generator<number, never> {
  let state = seed;
  for (;;) {
    state = (state * 48271) % 2147483647;
    yield state / 2147483647;
  }
}

export function buildHall(scene: THREE.Scene, facts: HallFacts, lite: boolean): void {
  scene.fog = new THREE.Fog(DARK, 26, 60);
  addFloor(scene, facts);
  addBoards(scene);
  addStands(scene, lite);
  scene.traverse((part) => part.layers.set(BEHIND));
  addNet(scene, facts, lite);
  addLights(scene, lite);
  if (lite) {
    simplify(scene);
  }
}

/** Replaces materials and textures by ones that are cheap in software rendering. */
export function simplify(parts: THREE.Object3D): void {
  const made = new Map<THREE.Material, THREE.Material>();
  parts.traverse((part) => {
    if (part instanceof THREE.Mesh && part.material instanceof THREE.MeshStandardMaterial) {
      const { name, color, map, transparent, opacity, side, depthWrite, emissive } = part.material;
      const plain =
        made.get(part.material) ??
        new THREE.MeshLambertMaterial({ name, color, map, transparent, opacity, side, depthWrite, emissive });
      made.set(part.material, plain);
      part.material = plain;
      if (map) {
        map.anisotropy = 1;
      }
    }
  });
}

function addLights(scene: THREE.Scene, lite: boolean): void {
  const sky = new THREE.HemisphereLight(0xe8f0ff, 0x27584a, 1.15);
  const key = new THREE.DirectionalLight(0xfff6e8, 2.1);
  key.position.set(-4, 13, -3);
  if (!lite) {
    key.castShadow = true;
    key.shadow.mapSize.set(2048, 2048);
    Object.assign(key.shadow.camera, { left: -6, right: 6, top: 9, bottom: -9, near: 2, far: 24 });
    key.shadow.bias = -0.0004;
    key.shadow.normalBias = 0.02;
    key.shadow.radius = 4;
  }
  const rim = new THREE.DirectionalLight(0xa9c8ff, 1.0);
  rim.position.set(6, 7, 9);
  for (const light of [sky, key, rim]) {
    light.layers.enable(BEHIND);
    scene.add(light);
  }
}

function addFloor(scene: THREE.Scene, { court }: HallFacts): void {
  const floor = new THREE.Mesh(
    new THREE.PlaneGeometry(44, 48),
    new THREE.MeshStandardMaterial({ color: FLOOR, roughness: 0.95 }),
  );
  floor.rotation.x = -Math.PI / 2;
  floor.position.y = -0.012;
  floor.receiveShadow = true;
  scene.add(floor);
  const [wide, long] = [court.width + 1.5, court.length + 1.8];
  const scale = 2048 / long;
  const texture = canvasTexture(Math.round(wide * scale), 2048, (g) => {
    const x = (metres: number) => (metres + wide / 2) * scale;
    const y = (metres: number) => (metres + long / 2) * scale;
    const shade = g.createLinearGradient(0, 0, 0, 2048);
    shade.addColorStop(0, "#0f6d51");
    shade.addColorStop(0.5, MAT_COLOUR);
    shade.addColorStop(1, "#0f6d51");
    g.fillStyle = shade;
    g.fillRect(0, 0, wide * scale, 2048);
    const random = numbers(7);
    for (let i = 0; i < 9000; i++) {
      g.fillStyle = `rgba(${random.next().value < 0.5 ? "0,0,0" : "255,255,255"},${0.035 * random.next().value})`;
      g.fillRect(wide * scale * random.next().value, 2048 * random.next().value, 2, 2);
    }
    g.fillStyle = "#f4f7f4";
    const w = court.line;
    const line = (x0: number, y0: number, x1: number, y1: number) =>
      g.fillRect(x(x0), y(y0), Math.max(x1 - x0, w) * scale, Math.max(y1 - y0, w) * scale);
    const [hx, hy] = [court.width / 2, court.length / 2];
    for (const side of [-1, 1]) {
      for (const edge of [hx, court.half_width]) {
        line(side > 0 ? edge - w : -edge, -hy, side > 0 ? edge : -edge + w, hy);
      }
      for (const row of [hy - w, hy - court.long_service - w / 2, court.short_service]) {
        line(-hx, side > 0 ? row : -row - w, hx, side > 0 ? row + w : -row);
      }
      line(-w / 2, side > 0 ? court.short_service : -hy, w / 2, side > 0 ? hy : -court.short_service);
    }
  });
  const mat = new THREE.Mesh(
    new THREE.PlaneGeometry(wide, long),
    new THREE.MeshStandardMaterial({ map: texture, roughness: 0.72 }),
  );
  mat.rotation.x = -Math.PI / 2;
  mat.receiveShadow = true;
  scene.add(mat);
}

function addNet(scene: THREE.Scene, { court }: HallFacts, lite: boolean): void {
  const top = (x: number) =>
    court.net_height_centre + (court.net_height - court.net_height_centre) * (x / (court.width / 2)) ** 2;
  const sag = (geometry: THREE.BufferGeometry) => {
    const position = geometry.getAttribute("position");
    for (let i = 0; i < position.count; i++) {
      position.setY(i, position.getY(i) + top(position.getX(i)));
    }
    geometry.computeVertexNormals();
    return geometry;
  };
  const mesh = canvasTexture(64, 64, (g) => {
    g.strokeStyle = "rgba(232,236,240,0.95)";
    g.lineWidth = 7;
    g.strokeRect(0, 0, 64, 64);
  });
  mesh.wrapS = mesh.wrapT = THREE.RepeatWrapping;
  mesh.repeat.set(122, 14);
  const hidden = 0.06; // behind the tape
  const depth = court.net_depth - hidden;
  const netting = new THREE.Mesh(
    sag(new THREE.PlaneGeometry(court.width, depth, 24, 1).translate(0, -hidden - depth / 2, 0)),
    new THREE.MeshStandardMaterial({
      map: mesh,
      transparent: true,
      side: THREE.DoubleSide,
      depthWrite: false,
      opacity: 0.85,
      roughness: 1,
    }),
  );
  const tape = new THREE.Mesh(
    sag(new THREE.BoxGeometry(court.width, court.tape, 0.014, 24, 1, 1).translate(0, -court.tape / 2, 0)),
    lite // its faces are a pixel high: with different shades the tape looks torn
      ? new THREE.MeshBasicMaterial({ color: 0xf0f0f0 })
      : new THREE.MeshStandardMaterial({ color: 0xffffff, roughness: 0.85, emissive: 0x333333 }),
  );
  tape.castShadow = true;
  scene.add(netting, tape);
  const metal = new THREE.MeshStandardMaterial({ color: 0xaab2bf, metalness: 0.4, roughness: 0.4 });
  for (const side of [-1, 1]) {
    const post = new THREE.Mesh(new THREE.CylinderGeometry(0.022, 0.026, court.net_height, 14), metal);
    post.position.set((side * court.width) / 2, court.net_height / 2, 0);
    const foot = new THREE.Mesh(new THREE.BoxGeometry(0.42, 0.14, 0.34), new THREE.MeshStandardMaterial({ color: 0x1d2735 }));
    foot.position.set(side * (court.width / 2 + 0.24), 0.07, 0);
    post.castShadow = foot.castShadow = true;
    scene.add(post, foot);
  }
}

function addBoards(scene: THREE.Scene): void {
  const texture = canvasTexture(2048, 128, (g) => {
    const ground = g.createLinearGradient(0, 0, 0, 128);
    ground.addColorStop(0, "#0c1830");
    ground.addColorStop(1, "#070d1a");
    g.fillStyle = ground;
    g.fillRect(0, 0, 2048, 128);
    g.font = "700 74px system-ui, 'DejaVu Sans', sans-serif";
    g.textBaseline = "middle";
    for (let i = 0; i < 3; i++) {
      g.fillStyle = i === 1 ? "#fb7185" : "#38bdf8";
      g.fillText("SHUTTLE·MARL", 40 + i * 683, 66);
    }
    g.fillStyle = "#1f6feb";
    g.fillRect(0, 120, 2048, 4);
  });
  texture.wrapS = THREE.RepeatWrapping;
  const board = (length: number, x: number, z: number, turn: number) => {
    const map = texture.clone();
    map.repeat.set(Math.round(length / 4) / 3, 1); // three words to a texture of 12 m, and whole ones only
    const mesh = new THREE.Mesh(new THREE.PlaneGeometry(length, 0.78), new THREE.MeshBasicMaterial({ map }));
    mesh.position.set(x, 0.39, z);
    mesh.rotation.y = turn;
    const back = new THREE.Mesh(new THREE.BoxGeometry(length, 0.8, 0.08), new THREE.MeshStandardMaterial({ color: 0x0a101c }));
    back.position.set(0, 0, -0.06);
    mesh.add(back);
    scene.add(mesh);
  };
  board(13, 0, 10.2, Math.PI);
  board(13, 0, -10.2, 0);
  board(19, 6.9, 0, -Math.PI / 2);
  board(19, -6.9, 0, Math.PI / 2);
}

/** Four stands with spectators. */
function addStands(scene: THREE.Scene, lite: boolean): void {
  const rows = lite ? 9 : 16;
  const random = numbers(20417);
  const spots: { spot: THREE.Vector3; turn: number }[] = [];
  const steps: THREE.BufferGeometry[] = [];
  for (let side = 0; side < 4; side++) {
    const turn = (side * Math.PI) / 2;
    const [reach, half] = side % 2 === 0 ? [12.2, 10.5] : [8.9, 13.5];
    for (let row = 0; row < rows; row++) {
      const distance = reach + row * 0.95;
      const height = 0.75 + row * 0.55;
      const length = 2 * half + row * 1.1;
      const step = new THREE.BoxGeometry(length, 0.55, 0.95).translate(0, height - 0.3, distance).rotateY(turn);
      steps.push(step);
      for (let x = -length / 2 + 0.4; x < length / 2; x += 0.62) {
        if (random.next().value < 0.86) {
          const spot = new THREE.Vector3(x + 0.12 * random.next().value, height, distance).applyAxisAngle(
            THREE.Object3D.DEFAULT_UP,
            turn,
          );
          spots.push({ spot, turn });
        }
      }
    }
  }
  const tiers = new THREE.Mesh(joined(steps), new THREE.MeshLambertMaterial({ color: 0x111a2b }));
  scene.add(tiers);
  const body = lite
    ? joined([
        new THREE.CylinderGeometry(0.19, 0.14, 0.5, 4, 1, true).translate(0, 0.25, 0), // few vertices: there are thousands
        new THREE.OctahedronGeometry(0.13).translate(0, 0.64, 0),
      ])
    : joined([
        new THREE.CylinderGeometry(0.2, 0.14, 0.46, 6, 1, true).scale(1, 1, 0.6).translate(0, 0.25, 0),
        new THREE.CylinderGeometry(0.06, 0.2, 0.07, 6, 1, true).scale(1, 1, 0.6).translate(0, 0.515, 0),
        new THREE.IcosahedronGeometry(0.115, 0).scale(0.85, 1.1, 0.95).translate(0, 0.66, 0),
        new THREE.BoxGeometry(0.3, 0.13, 0.36).translate(0, 0.07, -0.22),
      ]);
  const material = new THREE.MeshLambertMaterial({ color: 0xffffff });
  const crowd = new THREE.InstancedMesh(body, material, spots.length);
  const matrix = new THREE.Matrix4();
  const colour = new THREE.Color();
  spots.forEach(({ spot, turn }, i) => {
    const size = 0.9 + 0.25 * random.next().value;
    matrix
      .makeRotationY(turn)
      .scale(new THREE.Vector3(size, size, size))
      .setPosition(spot);
    crowd.setMatrixAt(i, matrix);
    const lively = random.next().value;
    colour.setHSL(
      lively < 0.25 ? random.next().value : 0.6 + 0.06 * random.next().value,
      lively < 0.25 ? 0.35 : 0.2,
      0.015 + 0.05 * random.next().value ** 2,
    );
    crowd.setColorAt(i, colour);
  });
  scene.add(crowd);
}

/** Merges geometries of one material into one draw call. */
export function joined(parts: THREE.BufferGeometry[]): THREE.BufferGeometry {
  const flat = parts.map((part) => (part.index ? part.toNonIndexed() : part));
  const out = new THREE.BufferGeometry();
  for (const name of ["position", "normal"]) {
    const arrays = flat.map((part) => part.getAttribute(name).array as Float32Array);
    const all = new Float32Array(arrays.reduce((sum, array) => sum + array.length, 0));
    let offset = 0;
    for (const array of arrays) {
      all.set(array, offset);
      offset += array.length;
    }
    out.setAttribute(name, new THREE.BufferAttribute(all, 3));
  }
  return out;
}

/** Layer of static objects behind all moving ones. */
export const BEHIND = 1;
const MAX_PICTURES = 4;

interface Picture {
  view: string;
  picture: THREE.FramebufferTexture;
}

export class Backdrop {
  private readonly screen = new THREE.Scene();
  private readonly flat = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);
  private readonly material: THREE.RawShaderMaterial;
  private pictures: Picture[] = [];
  private size = "";

  constructor(private readonly renderer: THREE.WebGLRenderer) {
    this.material = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      uniforms: { picture: { value: null }, part: { value: new THREE.Vector4() }, size: { value: new THREE.Vector2() } },
      vertexShader: "in vec3 position; void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }",
      fragmentShader: `precision mediump float; uniform sampler2D picture; uniform vec4 part; uniform vec2 size; out vec4 colour;
        void main() { colour = texture(picture, part.xy + part.zw * gl_FragCoord.xy / size); }`,
      depthTest: false,
      depthWrite: false,
    });
    const whole = new THREE.BufferGeometry().setAttribute(
      "position",
      new THREE.Float32BufferAttribute([-1, -1, 0, 3, -1, 0, -1, 3, 0], 3),
    );
    const sheet = new THREE.Mesh(whole, this.material);
    sheet.frustumCulled = false;
    this.screen.add(sheet);
  }

  /**
   * Renders a scene; the layer `BEHIND` is rendered once per view and cached.
   * @param widen sets the lens to the picture that is cached, and `narrow` to the one that is shown.
   * @param part the one that is shown in the cached one: corner and size.
   */
  render(
    scene: THREE.Scene,
    eye: THREE.PerspectiveCamera,
    widen: () => void,
    narrow: () => void,
    part: [number, number, number, number],
  ): void {
    const { renderer } = this;
    const { uniforms } = this.material;
    eye.updateMatrixWorld();
    widen();
    uniforms["picture"]!.value = this.pictureOf(scene, eye);
    narrow();
    uniforms["part"]!.value.set(...part);
    uniforms["size"]!.value.set(renderer.domElement.width, renderer.domElement.height);
    renderer.autoClear = false;
    renderer.render(this.screen, this.flat);
    renderer.clearDepth();
    eye.layers.set(0);
    renderer.render(scene, eye);
    eye.layers.enable(BEHIND);
    renderer.autoClear = true;
  }

  private pictureOf(scene: THREE.Scene, eye: THREE.PerspectiveCamera): THREE.FramebufferTexture {
    const { renderer } = this;
    const { width, height } = renderer.domElement;
    const size = `${width} ${height}`;
    if (size !== this.size) {
      this.size = size;
      this.pictures.forEach(({ picture }) => picture.dispose());
      this.pictures = [];
    }
    const view = [...eye.matrixWorld.elements, ...eye.projectionMatrix.elements].join();
    const found = this.pictures.find((one) => one.view === view);
    if (found) {
      return found.picture;
    }
    const picture =
      this.pictures.length < MAX_PICTURES ? new THREE.FramebufferTexture(width, height) : this.pictures.shift()!.picture;
    picture.magFilter = picture.minFilter = THREE.LinearFilter;
    eye.layers.set(BEHIND);
    renderer.render(scene, eye);
    renderer.copyFramebufferToTexture(picture);
    this.pictures.push({ view, picture });
    return picture;
  }
}
