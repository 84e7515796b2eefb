"use strict";
// Shows a rig: orbit controls, a pad that turns the eyes and moves the lids, and the rig's clip. `window.rig` is for scripts.
(() => {
  const part = (id) => document.getElementById(id);
  const [stage, canvas, status, pad, knob, angles, play, follow] =
    ["stage", "view", "status", "pad", "knob", "angles", "play", "follow"].map(part);
  const DEGREE = Math.PI / 180, FOV = 28, STEP = 2, KEY_TURN = 6 * DEGREE;
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const fail = (error) => { status.textContent = `The head cannot be shown: ${error.message || error}`; };

  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  } catch (error) {
    fail("this browser draws no WebGL");
    return;
  }
  const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(FOV, 1, 0.01, 20);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = !matchMedia("(prefers-reduced-motion: reduce)").matches;
  scene.add(new THREE.HemisphereLight(0xffffff, 0xb9b4ae, 2.4));
  const timer = new THREE.Timer();
  const state = { pitch: 0, yaw: 0, held: false, playing: false, following: false, dirty: true };

  const bytes = Uint8Array.from(atob(part("glb").textContent.trim()), (letter) => letter.charCodeAt(0));
  new THREE.GLTFLoader().parse(bytes.buffer, "", (gltf) => {
    try {
      start(gltf);
      status.textContent = "";
    } catch (error) {
      fail(error);
      throw error;
    }
  }, fail);

  function unlit(mesh) { // the light of the field's pictures is in the colours
    const map = mesh.material.map;
    mesh.material = new THREE.MeshBasicMaterial({ map, vertexColors: !map });
    if (map) map.anisotropy = renderer.capabilities.getMaxAnisotropy();
  }

  function fadeBelow(material, low, high) { // the cut neck, from height `high` down to `low`, metres
    material.transparent = true;
    material.onBeforeCompile = (shader) => {
      shader.vertexShader = "varying float vHeight;\n" + shader.vertexShader.replace("#include <project_vertex>",
        "#include <project_vertex>\nvHeight = (modelMatrix * vec4(transformed, 1.0)).y;");
      shader.fragmentShader = "varying float vHeight;\n" + shader.fragmentShader.replace("#include <alphatest_fragment>",
        `diffuseColor.a *= smoothstep(${low.toFixed(5)}, ${high.toFixed(5)}, vHeight);\n#include <alphatest_fragment>`);
    };
  }

  function start(gltf) {
    const head = gltf.scene.getObjectByName("head");
    const table = head.userData.gaze, limit = table.range_degrees;
    const eyes = table.eyes.map((name) => gltf.scene.getObjectByName(name));
    const face = gltf.scene.getObjectByName("face"), lids = table.lids || {};
    scene.add(gltf.scene);
    gltf.scene.traverse((object) => {
      if (object.isMesh && (object.material.map || object.geometry.attributes.color)) unlit(object);
    });
    const box = new THREE.Box3().setFromObject(gltf.scene), size = box.getSize(new THREE.Vector3());
    fadeBelow(face.material, box.min.y + 0.09 * size.y, box.min.y + 0.2 * size.y);
    const centre = box.getCenter(new THREE.Vector3()), middle = new THREE.Vector3();
    eyes.forEach((eye) => middle.addScaledVector(eye.getWorldPosition(new THREE.Vector3()), 1 / eyes.length));
    const mixer = gltf.animations.length ? new THREE.AnimationMixer(gltf.scene) : null;
    if (mixer) mixer.clipAction(gltf.animations[0]).play();
    part("range").textContent = `pitch ±${limit.pitch.toFixed(0)}° and yaw ±${limit.yaw.toFixed(0)}°, the gazes ` +
      (table.trained ? "that the head was learned from" : "of most datasets");
    pad.style.aspectRatio = `${limit.yaw} / ${limit.pitch}`;

    function show() { // what the pad says of the gaze
      const { pitch, yaw } = state;
      knob.style.left = `${50 + 50 * clamp(yaw / limit.yaw, -1, 1)}%`;
      knob.style.top = `${50 - 50 * clamp(pitch / limit.pitch, -1, 1)}%`;
      const plain = (value) => (Math.abs(value) < 0.05 ? 0 : value).toFixed(1);
      const text = `pitch ${plain(pitch)}°, yaw ${plain(yaw)}°`;
      if (angles.value !== text) angles.value = text;
      if (!state.playing || state.held) {
        pad.setAttribute("aria-valuetext", text.replaceAll("°", " degrees"));
        pad.setAttribute("aria-valuenow", plain(yaw));
      }
    }

    function turn(pitch, yaw) { // both eyes about their centres, lids by the rig's table
      state.pitch = clamp(pitch, -limit.pitch, limit.pitch);
      state.yaw = clamp(yaw, -limit.yaw, limit.yaw);
      for (const eye of eyes) eye.rotation.set(-state.pitch * DEGREE, state.yaw * DEGREE, 0, "YXZ");
      for (const [name, driver] of Object.entries(lids)) {
        const index = face.morphTargetDictionary?.[name];
        if (index !== undefined) face.morphTargetInfluences[index] = clamp(state[driver.angle] / driver.degrees, 0, 1);
      }
      state.dirty = true;
      show();
    }

    function read() { // the gaze of the clip, from the left eye
      const ahead = new THREE.Vector3(0, 0, 1).applyQuaternion(eyes[0].quaternion);
      state.pitch = Math.asin(clamp(ahead.y, -1, 1)) / DEGREE;
      state.yaw = Math.atan2(ahead.x, ahead.z) / DEGREE;
      show();
    }

    function setPlaying(on) {
      state.playing = on && mixer !== null;
      if (state.playing) setFollowing(false);
      play.textContent = state.playing ? "Pause" : "Play";
    }

    function setFollowing(on) {
      state.following = on;
      follow.setAttribute("aria-pressed", String(on));
      if (on) setPlaying(false);
      state.dirty = true;
    }

    function reset() {
      const tangent = Math.tan(0.5 * FOV * DEGREE), aspect = stage.clientWidth / Math.max(stage.clientHeight, 1);
      const away = 0.55 * Math.max(size.y, size.x / aspect) / tangent + 0.5 * size.z;
      controls.minDistance = 0.3 * away;
      controls.maxDistance = 4 * away;
      controls.target.copy(centre);
      camera.position.set(centre.x, centre.y, centre.z + away);
      controls.update();
      state.dirty = true;
    }

    function take(event) { // a pointer on the pad
      const area = pad.getBoundingClientRect();
      setFollowing(false);
      turn(limit.pitch * (1 - 2 * (event.clientY - area.top) / area.height),
        limit.yaw * (2 * (event.clientX - area.left) / area.width - 1));
    }
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      state.held = true;
      take(event);
    });
    pad.addEventListener("pointermove", (event) => { if (state.held) take(event); });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      pad.addEventListener(name, () => { state.held = false; });
    }
    const steps = { ArrowUp: [STEP, 0], ArrowDown: [-STEP, 0], ArrowLeft: [0, -STEP], ArrowRight: [0, STEP] };
    pad.addEventListener("keydown", (event) => {
      if (!(event.key in steps) && event.key !== "Home") return;
      event.preventDefault();
      setPlaying(false);
      setFollowing(false);
      if (event.key === "Home") turn(0, 0);
      else turn(state.pitch + steps[event.key][0], state.yaw + steps[event.key][1]);
    });
    const keys = {
      ArrowLeft: () => controls.rotateLeft(-KEY_TURN), ArrowRight: () => controls.rotateLeft(KEY_TURN),
      ArrowUp: () => controls.rotateUp(-KEY_TURN), ArrowDown: () => controls.rotateUp(KEY_TURN),
      "+": () => controls.dollyIn(1.1), "-": () => controls.dollyOut(1.1), Home: reset,
    };
    canvas.addEventListener("keydown", (event) => {
      if (!(event.key in keys)) return;
      event.preventDefault();
      keys[event.key]();
      controls.update();
      state.dirty = true;
    });
    play.addEventListener("click", () => setPlaying(!state.playing));
    follow.addEventListener("click", () => setFollowing(!state.following));
    part("straight").addEventListener("click", () => { setPlaying(false); setFollowing(false); turn(0, 0); });
    part("reset").addEventListener("click", reset);
    controls.addEventListener("change", () => { state.dirty = true; });
    if (!mixer) play.disabled = true;

    function resize() {
      const { clientWidth: width, clientHeight: height } = stage;
      if (!width || !height) return;
      renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      renderer.setSize(width, height, false);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      state.dirty = true;
    }
    new ResizeObserver(resize).observe(stage);
    resize();
    reset();
    read();

    renderer.setAnimationLoop((now) => {
      timer.update(now);
      if (state.playing && !state.held) {
        mixer.update(timer.getDelta());
        read();
        state.dirty = true;
      } else if (state.following) {
        const look = camera.position.clone().sub(middle).normalize();
        const pitch = Math.asin(look.y) / DEGREE, yaw = Math.atan2(look.x, look.z) / DEGREE;
        if (state.dirty) turn(pitch, yaw);
      }
      controls.update();
      if (!state.dirty) return;
      state.dirty = false;
      renderer.render(scene, camera);
    });
    setPlaying(!matchMedia("(prefers-reduced-motion: reduce)").matches);
    window.rig = { scene, camera, controls, eyes, face, state, turn, setPlaying, reset };
  }
})();
