// A table in which a configuration is chosen, and sliders.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const rows = [...document.querySelectorAll("tbody tr")];
  const controls = Object.fromEntries(["configuration", "opacity", "motion"].map((id) => [id, document.getElementById(id)]));
  const configurations = data.configurations.map((entry) => ({
    poses: new Float32Array(bytes(entry.poses)), contacts: entry.contacts,
  }));
  let chosen = 0;

  // An object that turns leads along rigid displacements (3 x 4, row by row), one that slides along a straight way.
  const station = () => data.stations[Math.round(controls.motion.value / 100 * (data.stations.length - 1))];
  const turned = (T, [x, y, z], w) => [0, 4, 8].map((row) => T[row] * x + T[row + 1] * y + T[row + 2] * z + T[row + 3] * w);
  const carried = (T, { poses, contacts }) => {
    const moved = poses.slice();
    data.bodies.forEach((entry, k) => {
      for (let column = 0; entry.moves && column < 4; column++) {
        const places = [0, 4, 8].map((row) => 12 * k + row + column);
        turned(T, places.map((place) => poses[place]), column === 3 ? 1 : 0).forEach((v, row) => { moved[places[row]] = v; });
      }
    });
    return { poses: moved, contacts: contacts.map((point) => turned(T, point, 1)) };
  };

  const redraw = createStage(data, () => {
    const opacity = controls.opacity.value / 100;
    if (data.stations.length) return { ...carried(station()[1], configurations[chosen]), move: [0, 0, 0], arrow: null, opacity };
    const move = data.motion.map((v) => v * data.motion_length * controls.motion.value / 100);
    return { ...configurations[chosen], move, arrow: data.has_arrow ? move : null, opacity };
  });
  if (!redraw) return;

  const show = () => {
    controls.configuration.nextElementSibling.value = rows[chosen].cells[0].textContent;
    controls.opacity.nextElementSibling.value = `${controls.opacity.value} %`;
    controls.motion.nextElementSibling.value = data.stations.length
      ? station()[0] : `${Math.round(data.motion_length * 10 * controls.motion.value)} mm`;
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
