// The 3D view of a sequence in the world: points of the depth images, camera, joint axes,
// trajectories, and the model if the page holds it. Returns nothing where there is no WebGL.
const numbers = (text, Kind = Float32Array) => new Kind(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);

function view3d(canvas, scene, joints, partColors, size) {
  const context = canvas.getContext("webgl2", {antialias: true, alpha: true});
  if (!context) return null;
  const renderer = new THREE.WebGLRenderer({canvas, context});
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  const world = new THREE.Scene(), eye = new THREE.PerspectiveCamera(40, 1, scene.radius / 100, scene.radius * 1000);
  eye.up.set(0, 0, 1);
  const sun = new THREE.DirectionalLight(0xffffff, .5);
  world.add(new THREE.HemisphereLight(0xffffff, 0x777777, .75), eye);
  world.children[0].position.set(0, 0, 1);
  sun.position.set(-1, 1, 1);
  eye.add(sun, sun.target);

  const poses = numbers(scene.poses), cameras = numbers(scene.camera), axes = numbers(scene.axes);
  const parts = partColors.length, ink = getComputedStyle(canvas).color;
  const place = (object, rows, at) => {
    const [a, b, c, d, e, f, g, h, i, j, k, l] = rows.subarray(12 * at, 12 * at + 12);
    object.matrix.set(a, b, c, d, e, f, g, h, i, j, k, l, 0, 0, 0, 1);
    object.matrixAutoUpdate = false;
    return object;
  };
  const geometry = (positions, faces) => {
    const made = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(positions, 3));
    return faces ? made.setIndex(new THREE.BufferAttribute(faces, 1)) : made;
  };
  const line = (positions, color, Kind = THREE.Line) => new Kind(geometry(positions), new THREE.LineBasicMaterial({color}));

  // ---- what is drawn
  const meshes = scene.meshes.map(({part, vertices, faces}) => {
    const mesh = new THREE.Mesh(geometry(numbers(vertices), numbers(faces, Uint16Array)),
      new THREE.MeshPhongMaterial({color: partColors[part], shininess: 0, flatShading: true, side: THREE.DoubleSide}));
    mesh.userData.part = part;
    mesh.frustumCulled = false;
    return mesh;
  });
  const points = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({size: 2, sizeAttenuation: false, vertexColors: true}));
  points.frustumCulled = false;
  const length = .7 * scene.radius, up = new THREE.Vector3(0, 1, 0), direction = new THREE.Vector3();
  const arrows = joints.map(({color, scored}) => {
    const wide = length * (scored ? .022 : .01), arrow = new THREE.Group();
    const paint = new THREE.MeshLambertMaterial({color, depthTest: !scored, transparent: scored});
    const shaft = new THREE.Mesh(new THREE.CylinderGeometry(wide, wide, 1.7 * length, 12), paint);
    const tip = new THREE.Mesh(new THREE.ConeGeometry(3 * wide, .2 * length, 20), paint);
    shaft.position.y = -.1 * length;
    tip.position.y = .85 * length;
    arrow.add(shaft, tip);
    return arrow;
  });
  const [fx, fy, cx, cy, skew] = scene.intrinsics;
  const ray = (u, v) => { const y = (v - cy) / fy; return [(u - cx - skew * y) / fx, y, 1]; };
  const [w, h] = size, eyeAt = new THREE.Vector3(cameras[3], cameras[7], cameras[11]);
  const center = new THREE.Vector3(...numbers(scene.center)), reach = .18 * eyeAt.distanceTo(center);
  const corners = [[-.5, -.5], [w - .5, -.5], [w - .5, h - .5], [-.5, h - .5]].map(c => ray(...c).map(x => x * reach));
  const edges = corners.flatMap((c, k) => [0, 0, 0, ...c, ...c, ...corners[(k + 1) % 4]]);
  const roof = ray(w / 2, -.15 * h).map(x => x * reach);
  const camera = line(new Float32Array([...edges, ...corners[0], ...roof, ...roof, ...corners[1]]), ink, THREE.LineSegments);
  const flown = new Float32Array(data.frames.flatMap((_, i) => [3, 7, 11].map(k => cameras[12 * i + k])));
  const trails = scene.trajectories.map(({points: text, color}) => {
    const path = numbers(text), trail = line(path, color);
    const dot = new THREE.Mesh(new THREE.SphereGeometry(.03 * scene.radius, 16, 12), new THREE.MeshLambertMaterial({color}));
    trail.add(dot);
    trail.userData = {path, dot};
    return trail;
  });
  world.add(points, ...meshes, ...arrows, camera, line(flown, ink), ...trails);
  for (const trail of trails) trail.frustumCulled = false;

  // ---- where it is seen from
  const orbit = {};
  function fromOutside() {
    const outside = eyeAt.clone().sub(center), far = Math.max(3.2 * scene.radius, 1.15 * outside.length()) / Math.min(eye.aspect, 1);
    Object.assign(orbit, {turn: Math.atan2(outside.y, outside.x) + .6, rise: Math.min(Math.asin(outside.z / outside.length()) + .15, 1.3), far,
      target: center.clone().addScaledVector(outside, .3), fov: 40});
  }
  function fromCamera(i) {
    const at = new THREE.Vector3(...[3, 7, 11].map(k => cameras[12 * i + k])), ahead = new THREE.Vector3(...[2, 6, 10].map(k => cameras[12 * i + k]));
    const far = Math.max(ahead.dot(center.clone().sub(at)), scene.radius / 10);
    Object.assign(orbit, {turn: Math.atan2(-ahead.y, -ahead.x), rise: Math.asin(-ahead.z), far, target: at.addScaledVector(ahead, far),
      fov: 2 * Math.atan(h / (2 * fy) * Math.max(1, w / h / eye.aspect)) * 180 / Math.PI});
  }
  let waiting = false;
  function render() {
    if (waiting || !orbit.target) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      const {turn, rise, far, target} = orbit;
      eye.position.set(Math.cos(turn) * Math.cos(rise), Math.sin(turn) * Math.cos(rise), Math.sin(rise)).multiplyScalar(far).add(target);
      eye.lookAt(target);
      eye.fov = orbit.fov;
      eye.updateProjectionMatrix();
      renderer.render(world, eye);
    });
  }
  const turn = (x, y) => { orbit.turn -= x; orbit.rise = Math.min(Math.max(orbit.rise + y, -1.55), 1.55); render(); };
  const zoom = factor => { orbit.far = Math.min(Math.max(orbit.far * factor, scene.radius / 10), scene.radius * 100); render(); };
  const held = new Map();
  const apart = () => { const [a, b] = [...held.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("pointerdown", event => { held.set(event.pointerId, {x: event.clientX, y: event.clientY}); canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointermove", event => {
    const last = held.get(event.pointerId);
    if (!last) return;
    const before = held.size === 2 && apart(), here = {x: event.clientX, y: event.clientY};
    held.set(event.pointerId, here);
    if (before) zoom(before / Math.max(apart(), 1));
    else turn((here.x - last.x) / 150, (here.y - last.y) / 150);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => held.delete(event.pointerId));
  canvas.addEventListener("wheel", event => {
    if (document.activeElement !== canvas) return;  // until a click, the wheel scrolls the page
    event.preventDefault();
    zoom(Math.exp(event.deltaY / 500));
  }, {passive: false});
  new ResizeObserver(([{contentRect: box}]) => {
    renderer.setSize(box.width, box.height, false);
    eye.aspect = box.width / Math.max(box.height, 1);
    if (!orbit.target) fromOutside();
    render();
  }).observe(canvas.parentElement);

  return {
    zoom,
    fromOutside() { fromOutside(); render(); },
    fromCamera(i) { fromCamera(i); render(); },
    pose(i, model) {
      for (const mesh of meshes) place(mesh, poses, i * parts + mesh.userData.part).visible = model;
      place(camera, cameras, i);
      arrows.forEach((arrow, j) => {
        const [x, y, z, ...along] = axes.subarray(6 * (i * joints.length + j), 6 * (i * joints.length + j) + 6);
        arrow.position.set(x, y, z);
        arrow.quaternion.setFromUnitVectors(up, direction.set(...along));
      });
      for (const {userData: {path, dot}} of trails) dot.position.fromArray(path, 3 * i);
      render();
    },
    // `pixels`: u, v, depth, red, green, blue of each point
    cloud(i, pixels) {
      const n = pixels.length / 6, positions = new Float32Array(3 * n), colors = new Float32Array(3 * n);
      const m = cameras.subarray(12 * i, 12 * i + 12);
      for (let p = 0; p < n; p++) {
        const [u, v, z, ...rgb] = pixels.subarray(6 * p, 6 * p + 6), [x, y] = ray(u, v);
        for (let k = 0; k < 3; k++) {
          positions[3 * p + k] = (m[4 * k] * x + m[4 * k + 1] * y + m[4 * k + 2]) * z + m[4 * k + 3];
          colors[3 * p + k] = rgb[k] / 255;
        }
      }
      points.geometry.dispose();
      points.geometry = geometry(positions).setAttribute("color", new THREE.BufferAttribute(colors, 3));
      render();
    },
  };
}
