// Sliders for the surroundings and for the object on its way.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const [opacity, motion] = ["opacity", "motion"].map((id) => document.getElementById(id));
  const poses = new Float32Array(bytes(data.configurations[0].poses));

  const redraw = createStage(data, () => {
    const move = data.motion.map((v) => v * data.motion_length * motion.value / 100);
    return { poses, contacts: [], move, arrow: data.motion.some((v) => v) ? [0, 0, 0] : null, opacity: opacity.value / 100 };
  });
  if (!redraw) return;

  const show = () => {
    opacity.nextElementSibling.value = `${opacity.value} %`;
    motion.nextElementSibling.value = `${Math.round(data.motion_length * 10 * motion.value)} mm`;
    redraw();
  };
  opacity.addEventListener("input", show);
  motion.addEventListener("input", show);
  show();
})();
