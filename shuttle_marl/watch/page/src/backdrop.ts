// What does not move, drawn once for each view and then put behind everything else: most pixels of a picture cost time only once.

import * as THREE from "three";

/** Layer of what does not move and stands behind all that does. */
export const BEHIND = 1;
const KEPT = 4;

interface Kept {
  view: string;
  picture: THREE.FramebufferTexture;
}

export class Backdrop {
  private readonly screen = new THREE.Scene();
  private readonly flat = new THREE.OrthographicCamera(-1, 1, 1, -1, 0, 1);
  private readonly material: THREE.RawShaderMaterial;
  private kept: Kept[] = [];
  private size = "";

  constructor(private readonly renderer: THREE.WebGLRenderer) {
    // The picture is that of the canvas already: it is copied pixel by pixel.
    this.material = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3,
      uniforms: { picture: { value: null } },
      vertexShader: "in vec3 position; void main() { gl_Position = vec4(position.xy, 0.0, 1.0); }",
      fragmentShader:
        "precision mediump float; uniform sampler2D picture; out vec4 colour; void main() { colour = texelFetch(picture, ivec2(gl_FragCoord.xy), 0); }",
      depthTest: false,
      depthWrite: false,
    });
    const whole = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute([-1, -1, 0, 3, -1, 0, -1, 3, 0], 3));
    const sheet = new THREE.Mesh(whole, this.material);
    sheet.frustumCulled = false;
    this.screen.add(sheet);
  }

  /** Draws a scene as an eye sees it, from `BEHIND` only what is not known of this view yet. */
  render(scene: THREE.Scene, eye: THREE.PerspectiveCamera): void {
    const { renderer } = this;
    eye.updateMatrixWorld();
    const behind = this.pictureOf(scene, eye);
    this.material.uniforms["picture"]!.value = behind;
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
      this.kept.forEach(({ picture }) => picture.dispose());
      this.kept = [];
    }
    const view = [...eye.matrixWorld.elements, ...eye.projectionMatrix.elements].join();
    const found = this.kept.find((one) => one.view === view);
    if (found) {
      return found.picture;
    }
    const picture = this.kept.length < KEPT ? new THREE.FramebufferTexture(width, height) : this.kept.shift()!.picture;
    eye.layers.set(BEHIND);
    renderer.render(scene, eye);
    renderer.copyFramebufferToTexture(picture);
    this.kept.push({ view, picture });
    return picture;
  }
}
