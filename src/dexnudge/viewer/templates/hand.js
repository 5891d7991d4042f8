// A slider for each joint; forward kinematics as in hands/hand.py.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const sliders = [...document.querySelectorAll("#joints input")];
  const angles = data.poses[0].angles.slice();

  // Poses are 3 x 4, row by row.
  const times = (a, b) => [0, 1, 2].flatMap((row) => [0, 1, 2, 3].map((column) =>
    a[4 * row] * b[column] + a[4 * row + 1] * b[4 + column] + a[4 * row + 2] * b[8 + column] + (column === 3 ? a[4 * row + 3] : 0)));
  const motion = ({ axis: [x, y, z], slides }, by) => {
    if (slides) return [1, 0, 0, x * by, 0, 1, 0, y * by, 0, 0, 1, z * by];
    const c = Math.cos(by), s = Math.sin(by), d = 1 - c;
    return [c + x * x * d, x * y * d - z * s, x * z * d + y * s, 0,
      y * x * d + z * s, c + y * y * d, y * z * d - x * s, 0,
      z * x * d - y * s, z * y * d + x * s, c + z * z * d, 0];
  };
  const poses = new Float32Array(12 * data.bodies.length);
  const place = () => {
    const links = [];
    data.links.forEach((link) => {
      if (link.parent < 0) { links.push(data.root); return; }
      const here = times(links[link.parent], link.origin);
      links.push(link.index === null ? here : times(here, motion(link, link.multiplier * angles[link.index] + link.offset)));
    });
    data.body_links.forEach((link, k) => poses.set(link === null ? [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0] : links[link], 12 * k));
  };

  const redraw = createStage(data, () => ({ poses, contacts: [], move: [0, 0, 0], arrow: null, opacity: 0 }));
  const show = () => {
    data.couplings.forEach(([follower, leader]) => { angles[follower] = Math.min(angles[follower], angles[leader]); });
    sliders.forEach((slider, k) => {
      slider.value = angles[k];
      const { slides } = data.joints[k];
      slider.nextElementSibling.value = slides ? `${(1000 * angles[k]).toFixed(1)} mm` : `${(180 / Math.PI * angles[k]).toFixed(0)}°`;
    });
    place();
    if (redraw) redraw();
  };
  sliders.forEach((slider, k) => slider.addEventListener("input", () => { angles[k] = Number(slider.value); show(); }));
  document.querySelectorAll("#poses button").forEach((button, k) => button.addEventListener("click", () => {
    angles.splice(0, angles.length, ...data.poses[k].angles);
    show();
  }));
  show();
})();
