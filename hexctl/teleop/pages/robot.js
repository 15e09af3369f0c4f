// The robot as the server's joint angles have it: legs are polylines from mount to foot, in stance radii, body frame.
const COLORS = { body: "#33475c", link: "#c9d3dd", air: "#4aa3df", failed: "#d8433b", lit: "#f0a030", floor: "#26313c" };
function drawRobot(canvas, legs, view) {   // view: azimuth and elevation in rad, lit: [leg, link] or none
  const ratio = window.devicePixelRatio || 1, wide = canvas.clientWidth, high = canvas.clientHeight, pen = canvas.getContext("2d");
  if (!wide || !high) return;
  if (canvas.width !== Math.round(wide * ratio) || canvas.height !== Math.round(high * ratio)) {
    canvas.width = Math.round(wide * ratio); canvas.height = Math.round(high * ratio);
  }
  const ca = Math.cos(view.azimuth), sa = Math.sin(view.azimuth), ce = Math.cos(view.elevation), se = Math.sin(view.elevation);
  const reach = Math.max(1.15, ...legs.flatMap(leg => leg.points.map(([x, y]) => Math.hypot(x, y)))) + 0.1;
  const floor = Math.min(...legs.map(leg => leg.points[3][2]));
  const scale = Math.min(wide / 2 / reach, high / 2 / (reach * se + 0.62 * ce));
  const seen = ([x, y, z]) => {            // right, down and away on the screen
    const away = x * ca + y * sa, left = y * ca - x * sa;
    return [wide / 2 - left * scale, high / 2 - ((z - floor / 2) * ce + away * se) * scale, away * ce - z * se];
  };
  const path = points => { pen.beginPath(); points.forEach((p, i) => { const [u, v] = seen(p); i ? pen.lineTo(u, v) : pen.moveTo(u, v); }); };
  const stroke = scale * 0.075;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.clearRect(0, 0, wide, high); pen.lineCap = pen.lineJoin = "round";
  pen.strokeStyle = COLORS.floor; pen.lineWidth = 1;
  for (let k = -3; k <= 3; k++) {
    const far = 1.5, at = k * far / 3;
    path([[at, -far, floor], [at, far, floor]]); pen.stroke();
    path([[-far, at, floor], [far, at, floor]]); pen.stroke();
  }
  const parts = legs.map((leg, number) => ({ depth: seen(leg.points[3])[2], draw: () => drawLeg(leg, number) }));
  parts.push({ depth: 0, draw: drawBody });
  parts.sort((a, b) => b.depth - a.depth).forEach(part => part.draw());

  function drawBody() {
    const rim = legs.map(leg => leg.points[0]), top = rim.map(([x, y, z]) => [x, y, z + 0.06]), low = rim.map(([x, y, z]) => [x, y, z - 0.06]);
    pen.fillStyle = COLORS.body; pen.strokeStyle = COLORS.link; pen.lineWidth = 1.5;
    for (const face of [low, ...rim.map((_, i) => [low[i], low[(i + 1) % 6], top[(i + 1) % 6], top[i]])]) { path(face); pen.closePath(); pen.fill(); }
    path(top); pen.closePath(); pen.fill(); pen.stroke();
    const [u, v] = seen([top[0][0] * 0.6, 0, top[0][2]]);  // where its front is
    pen.beginPath(); pen.arc(u, v, stroke * 0.5, 0, 7); pen.fillStyle = COLORS.link; pen.fill();
  }
  function drawLeg(leg, number) {
    const lit = view.lit && view.lit[0] === number ? view.lit[1] : -1;
    const color = leg.state ? COLORS[leg.state] : COLORS.link;
    for (let link = 0; link < 3; link++) {
      path(leg.points.slice(link, link + 2));
      pen.strokeStyle = link === lit ? COLORS.lit : color; pen.lineWidth = stroke * (1.25 - 0.3 * link); pen.stroke();
    }
    const [u, v] = seen(leg.points[3]);
    pen.beginPath(); pen.arc(u, v, stroke * 0.6, 0, 7); pen.fillStyle = pen.strokeStyle = color; pen.lineWidth = 2;
    leg.state === "air" ? pen.stroke() : pen.fill();       // on the floor: filled
    if (lit >= 0) {
      const [x, y] = seen(leg.points[lit]);
      pen.beginPath(); pen.arc(x, y, stroke * 1.1, 0, 7); pen.strokeStyle = COLORS.lit; pen.lineWidth = 3; pen.stroke();
    }
  }
}
