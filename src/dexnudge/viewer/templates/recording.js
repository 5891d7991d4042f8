// A slider over time, play and pause, and a cursor in every chart.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const [slider, speed, opacity] = ["frame", "speed", "opacity"].map((id) => document.getElementById(id));
  const button = document.querySelector("#player button");
  const charts = [...document.querySelectorAll("#charts svg")];
  const cursors = charts.map((chart) => chart.querySelector(".cursor"));
  const readings = [...document.querySelectorAll("#charts [data-value]")];
  const poses = data.configurations.map((entry) => new Float32Array(bytes(entry.poses)));
  const begin = data.time[0], end = data.time[data.time.length - 1];
  let now = 0;

  const still = [0, 0, 0];
  const redraw = createStage(data, () => ({
    poses: poses[now], contacts: [], move: still, arrow: data.arrows[now] ? still : null, opacity: opacity.value / 100,
  }));

  const show = (index) => {
    now = Math.min(poses.length - 1, Math.max(0, index));
    slider.value = now;
    slider.nextElementSibling.value = `${data.time[now].toFixed(2)} s ${data.phase[now]}`;
    opacity.nextElementSibling.value = `${opacity.value} %`;
    const share = (data.time[now] - begin) / Math.max(end - begin, 1e-9);
    charts.forEach((chart, k) => {
      const x = Number(chart.dataset.left) + share * Number(chart.dataset.width);
      cursors[k].setAttribute("x1", x);
      cursors[k].setAttribute("x2", x);
    });
    readings.forEach((reading, k) => {
      const { values, unit } = data.curves[k];
      reading.textContent = values[now] === null ? "\u2013" : `${(Math.round(10 * values[now]) / 10 || 0).toFixed(1)} ${unit}`;
    });
    if (redraw) redraw();
  };
  const at = (time) => {
    let low = 0, high = poses.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (data.time[middle] <= time) low = middle; else high = middle - 1;
    }
    return low;
  };

  let playing = false, time = begin, last = 0;
  const tick = (clock) => {
    if (!playing) return;
    time += Number(speed.value) * (clock - last) / 1000;
    last = clock;
    if (time >= end) { time = end; pause(); }
    show(at(time));
    requestAnimationFrame(tick);
  };
  const pause = () => { playing = false; button.textContent = "play"; };
  const play = () => {
    time = now === poses.length - 1 ? begin : data.time[now];
    playing = true;
    button.textContent = "pause";
    requestAnimationFrame((clock) => { last = clock; tick(clock); });
  };
  const stop = (index) => { pause(); show(index); };

  button.addEventListener("click", () => (playing ? pause() : play()));
  slider.addEventListener("input", () => stop(Number(slider.value)));
  opacity.addEventListener("input", () => show(now));
  charts.forEach((chart) => chart.addEventListener("click", (event) => {
    const box = chart.getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width * chart.viewBox.baseVal.width;
    stop(at(begin + (x - Number(chart.dataset.left)) / Number(chart.dataset.width) * (end - begin)));
  }));
  window.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (step) { event.preventDefault(); stop(now + step); }
    if (event.key === " " && document.activeElement !== button) { event.preventDefault(); button.click(); }
  });

  // A link may point at a moment: film.html#1.5 opens at 1.5 s.
  const asked = Number(location.hash.slice(1));
  show(location.hash && Number.isFinite(asked) ? at(asked) : 0);
})();
