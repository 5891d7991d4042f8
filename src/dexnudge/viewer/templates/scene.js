// Sliders for the surroundings and for the object on its way.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const [opacity, motion] = ["opacity", "motion"].map((id) => document.getElementById(id));
  const poses = data.configurations.map((each) => new Float32Array(bytes(each.poses)));
  const place = () => Math.round(motion.value / 100 * (poses.length - 1));

  const redraw = createStage(data, () => {
    const still = [0, 0, 0];
    return { poses: poses[place()], contacts: [], move: still, arrow: data.has_arrow ? still : null, opacity: opacity.value / 100 };
  });
  if (!redraw) return;

  const show = () => {
    opacity.nextElementSibling.value = `${opacity.value} %`;
    motion.nextElementSibling.value = data.labels[place()];
    redraw();
  };
  opacity.addEventListener("input", show);
  motion.addEventListener("input", show);
  show();
})();
