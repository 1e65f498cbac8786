// An athlete: the skinned model, posed bone by bone, with a racket in the hand.

import * as THREE from "three";
import { DecalGeometry } from "three/addons/geometries/DecalGeometry.js";
import { at, canvasTexture, joined } from "./hall";
import type { Motion } from "./motion";
import type { AthleteFacts, HallFacts, Quat, Vec3 } from "./wire.gen";

type Coloured = THREE.MeshStandardMaterial | THREE.MeshLambertMaterial;

export interface Kit {
  skin: number;
  hair: number;
  shirt: number;
  shorts: number;
  racket: number;
}

function turned(q: Quat | ArrayLike<number>, i = 0, out = new THREE.Quaternion()): THREE.Quaternion {
  return out.set(-q[i]!, q[i + 2]!, q[i + 1]!, q[i + 3]!);
}

export class Athlete {
  readonly root = new THREE.Group();
  private readonly sweetSpot = new THREE.Object3D();
  private readonly bones: (THREE.Object3D | undefined)[];
  private readonly crown = new THREE.Object3D(); // top of the head
  private readonly racketBone: number;
  private readonly racket: THREE.Group;
  private readonly rotations: Float64Array;
  private readonly hips: Vec3 = [0, 0, 0];

  /** @param name printed on the back of the shirt. */
  constructor(model: THREE.Object3D, facts: HallFacts, me: AthleteFacts, kit: Kit, name: string) {
    this.root.add(model);
    const tint: Record<string, number> = { skin: kit.skin, hair: kit.hair, shirt: kit.shirt, shorts: kit.shorts };
    let shirt: THREE.Mesh | null = null;
    const materials = new Map<THREE.Material, THREE.Material>();
    model.traverse((part) => {
      if (part instanceof THREE.Mesh) {
        part.castShadow = true;
        part.frustumCulled = false;
        const old = part.material as Coloured;
        const material = materials.get(old) ?? old.clone();
        materials.set(old, material);
        if (old.name === "shirt") {
          shirt = part;
        }
        if (old.name in tint) {
          (material as Coloured).color.set(tint[old.name]!);
        }
        part.material = material;
      }
    });
    this.bones = facts.bones.map((name) => model.getObjectByName(name));
    this.racketBone = facts.bones.indexOf("Racket");
    this.rotations = new Float64Array(facts.bones.length * 4);
    for (const [name, turn] of Object.entries(me.fingers)) {
      const finger = model.getObjectByName(name);
      if (finger) {
        turned(turn, 0, finger.quaternion);
      }
    }
    const hand = me.parents[this.racketBone]!;
    const [grip, wrist] = [me.rest[this.racketBone]!, me.rest[hand]!];
    this.racket = makeRacket(facts, me, kit.racket);
    this.racket.position.copy(at(grip[0] - wrist[0], grip[1] - wrist[1], grip[2] - wrist[2]));
    this.sweetSpot.position.copy(at(...me.shaft).multiplyScalar(facts.racket.sweet_spot));
    this.racket.add(this.sweetSpot);
    this.bones[hand]!.add(this.racket);
    const head = facts.bones.indexOf("Head");
    this.crown.position.copy(at(0, 0, me.height - me.rest[head]![2]));
    this.bones[head]!.add(this.crown);
    this.root.updateMatrixWorld(true);
    if (shirt) {
      printName(shirt, model.getObjectByName("Spine2")!, name);
    }
  }

  /** Sets the pose of a player at a time. */
  pose(motion: Motion, time: number, seat: number): void {
    motion.rotationsAt(time, seat, this.rotations);
    this.bones[0]!.position.copy(at(...motion.hipsAt(time, seat, this.hips)));
    this.bones.forEach((bone, i) => turned(this.rotations, i * 4, (i === this.racketBone ? this.racket : bone!).quaternion));
  }

  /** The joints and the top of the head, in the axes of the scene. */
  body(): THREE.Vector3[] {
    return [...this.bones, this.crown].filter((part) => part !== undefined).map(placeOf);
  }

  /** The middle of the strings, in the axes of the scene. */
  strings(): THREE.Vector3 {
    placeOf(this.racket);
    return placeOf(this.sweetSpot);
  }

  /** Blends the pose with that of another motion; `share` is the weight of the current pose. */
  moveFrom(motion: Motion, time: number, seat: number, share: number): void {
    motion.rotationsAt(time, seat, this.rotations);
    const old = new THREE.Quaternion();
    this.bones[0]!.position.lerp(at(...motion.hipsAt(time, seat, this.hips)), 1 - share);
    this.bones.forEach((bone, i) =>
      (i === this.racketBone ? this.racket : bone!).quaternion.slerp(turned(this.rotations, i * 4, old), 1 - share),
    );
  }
}

/** Where a part is, whose parent is up to date. */
function placeOf(part: THREE.Object3D): THREE.Vector3 {
  part.updateWorldMatrix(false, false);
  return new THREE.Vector3().setFromMatrixPosition(part.matrixWorld);
}

/** Prints a name between the shoulder blades of a shirt in its rest pose; it moves with the chest. */
function printName(shirt: THREE.Mesh, chest: THREE.Object3D, name: string): void {
  const map = canvasTexture(512, 144, (g) => {
    g.font = "700 116px system-ui, 'DejaVu Sans', sans-serif";
    g.textAlign = "center";
    g.textBaseline = "middle";
    g.fillStyle = "#f8fafc";
    g.fillText(name.toUpperCase(), 256, 76, 430);
  });
  chest.updateWorldMatrix(true, false);
  const middle = chest.getWorldPosition(new THREE.Vector3());
  middle.z -= 0.07; // the back is behind the spine
  const size = new THREE.Vector3(0.34, 0.095, 0.2);
  const geometry = new DecalGeometry(shirt, middle, new THREE.Euler(0, Math.PI, 0), size);
  geometry.applyMatrix4(chest.matrixWorld.clone().invert());
  const material = new THREE.MeshLambertMaterial({ map, transparent: true, depthWrite: false });
  Object.assign(material, { polygonOffset: true, polygonOffsetFactor: -4 });
  const print = new THREE.Mesh(geometry, material);
  print.frustumCulled = false;
  chest.add(print);
}

class Ring extends THREE.Curve<THREE.Vector3> {
  constructor(
    private readonly middle: number,
    private readonly half: number,
    private readonly wide: number,
  ) {
    super();
  }
  override getPoint(t: number, out = new THREE.Vector3()): THREE.Vector3 {
    const angle = 2 * Math.PI * t;
    return out.set(this.wide * Math.sin(angle), this.middle + this.half * Math.cos(angle), 0);
  }
}

/** A racket whose shaft is the y axis and whose strings face z, rotated into the hand. */
function makeRacket({ racket }: HallFacts, me: AthleteFacts, colour: number): THREE.Group {
  const [middle, [half, wide]] = [racket.sweet_spot, racket.head];
  const inner = new THREE.Group();
  const add = (geometry: THREE.BufferGeometry, material: THREE.Material, shadow = true) => {
    const mesh = new THREE.Mesh(geometry, material);
    mesh.castShadow = shadow;
    inner.add(mesh);
  };
  const standard = (color: number, roughness: number, metalness = 0) =>
    new THREE.MeshStandardMaterial({ color, roughness, metalness });
  add(new THREE.CylinderGeometry(0.0135, 0.0165, -2 * racket.butt, 10), standard(0xe9e9ee, 0.9));
  const neck = middle - half;
  const shaft = new THREE.CylinderGeometry(0.0075, 0.0085, neck + racket.butt, 8).translate(0, (neck - racket.butt) / 2, 0);
  const ring = new THREE.TubeGeometry(new Ring(middle, half, wide), 48, 0.0085, 8, true);
  add(joined([shaft, ring]), standard(colour, 0.3, 0.35));
  const ends: number[] = [];
  for (let i = -7; i <= 7; i++) {
    const u = i / 8;
    const reach = Math.sqrt(1 - u * u);
    ends.push(wide * u, middle - half * reach, 0, wide * u, middle + half * reach, 0);
    ends.push(-wide * reach, middle + half * u, 0, wide * reach, middle + half * u, 0);
  }
  const strings = new THREE.BufferGeometry();
  strings.setAttribute("position", new THREE.Float32BufferAttribute(ends, 3));
  inner.add(new THREE.LineSegments(strings, new THREE.LineBasicMaterial({ color: 0xf6f7f2, transparent: true, opacity: 0.7 })));
  const shaftWay = at(...me.shaft).normalize();
  const face = at(...me.strings).normalize();
  const aside = new THREE.Vector3().crossVectors(shaftWay, face).normalize();
  inner.quaternion.setFromRotationMatrix(
    new THREE.Matrix4().makeBasis(aside, shaftWay, new THREE.Vector3().crossVectors(aside, shaftWay)),
  );
  const group = new THREE.Group();
  group.add(inner);
  return group;
}
