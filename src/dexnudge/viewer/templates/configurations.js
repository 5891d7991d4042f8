// A table in which a configuration is chosen, and sliders.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const rows = [...document.querySelectorAll("tbody tr")];
  const controls = Object.fromEntries(["configuration", "opacity", "motion"].map((id) => [id, document.getElementById(id)]));
  const configurations = data.configurations.map((entry) => ({
    poses: new Float32Array(bytes(entry.poses)), contacts: entry.contacts,
  }));
  let chosen = 0;

  const redraw = createStage(data, () => {
    const move = data.motion.map((v) => v * data.motion_length * controls.motion.value / 100);
    return { ...configurations[chosen], move, arrow: move, opacity: controls.opacity.value / 100 };
  });
  if (!redraw) return;

  const show = () => {
    controls.configuration.nextElementSibling.value = `${chosen + 1} / ${rows.length}`;
    controls.opacity.nextElementSibling.value = `${controls.opacity.value} %`;
    controls.motion.nextElementSibling.value = `${Math.round(data.motion_length * 10 * controls.motion.value)} mm`;
    redraw();
  };
  const choose = (index) => {
    rows[chosen].classList.remove("chosen");
    chosen = Math.min(rows.length - 1, Math.max(0, index));
    rows[chosen].classList.add("chosen");
    rows[chosen].scrollIntoView({ block: "nearest" });
    controls.configuration.value = chosen;
    show();
  };
  rows.forEach((row, index) => row.addEventListener("click", () => choose(index)));
  controls.configuration.addEventListener("input", () => choose(Number(controls.configuration.value)));
  controls.opacity.addEventListener("input", show);
  controls.motion.addEventListener("input", show);
  window.addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step) { event.preventDefault(); choose(chosen + step); }
  });

  choose(0);
})();
