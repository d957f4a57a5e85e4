// Drawing groups, places, looks and forecasts of a moment on the replay's canvas.

const CROWD = 40;  // people at a time beyond which dashes and areas of forecasts are left out: browsers take too long over them
const FEW = 3;  // up to this many people all forecast circles are drawn; above it only for the selected or hovered person

function traceOutline(ctx, view, outline) {
  ctx.beginPath();
  outline.forEach(([x, y]) => ctx.lineTo(...toScreen(view, x, y)));
  ctx.closePath();
}

function drawPlaces(ctx, view, places, theme) {
  ctx.strokeStyle = theme.muted; ctx.fillStyle = theme.muted; ctx.lineWidth = 1.2; ctx.setLineDash([2, 3]);
  places.forEach((place) => {
    if (place.radius > 0) {
      ctx.beginPath(); ctx.arc(...toScreen(view, place.x, place.y), Math.max(place.radius * view.scale, 3), 0, TURN);
    } else traceOutline(ctx, view, place.outline);
    ctx.globalAlpha = 0.12; ctx.fill(); ctx.globalAlpha = 1; ctx.stroke();
  });
  ctx.setLineDash([]);
}

function drawPlaceNames(ctx, view, places, theme) {
  ctx.font = "12px system-ui, sans-serif"; ctx.textAlign = "center"; ctx.lineWidth = 3; ctx.strokeStyle = theme.surface; ctx.fillStyle = theme.muted;
  places.forEach((place) => {
    const [sx, sy] = toScreen(view, place.x, place.y);
    ctx.strokeText(place.name, sx, sy + 4); ctx.fillText(place.name, sx, sy + 4);
  });
  ctx.textAlign = "left";
}

// Those who walk together have a dashed edge and no o-space; what is less probable is fainter.
function drawGroups(ctx, view, groups, crowded) {
  groups.forEach(({ group, kind, p, members, centre, radius }) => {
    const sure = Number.isFinite(p) ? 0.35 + 0.65 * p : 1;
    traceOutline(ctx, view, hullOf(members));
    ctx.fillStyle = ctx.strokeStyle = group.colour;
    ctx.globalAlpha = 0.2 * sure; ctx.fill();
    ctx.globalAlpha = 0.9 * sure; ctx.lineWidth = 1.4; ctx.setLineDash(kind === 2 && !crowded ? [7, 4] : []); ctx.stroke();
    ctx.setLineDash([]);
    if (kind !== 2 && Number.isFinite(centre[0]) && members.length > 1) {
      ctx.beginPath(); ctx.arc(...toScreen(view, ...centre), radius * view.scale, 0, TURN);
      ctx.globalAlpha = 0.25 * sure; ctx.fill();
      ctx.globalAlpha = 0.9 * sure; ctx.setLineDash(crowded ? [] : [2, 2]); ctx.stroke(); ctx.setLineDash([]);
    }
    ctx.globalAlpha = 1;
  });
}

// All circles as one area: where they overlap they are no darker.
function fillCircles(ctx, view, circles, alpha) {
  ctx.beginPath();
  circles.forEach(([sx, sy, metresWide]) => { ctx.moveTo(sx + metresWide * view.scale, sy); ctx.arc(sx, sy, metresWide * view.scale, 0, TURN); });
  ctx.globalAlpha = alpha; ctx.fill();
}

// What holds 90 % as an edge at the last time and, of one to be made plain, at all; what holds 50 % as an area.
function drawFan(ctx, view, person, state, fan, plain) {
  const steps = fan.steps.map((step) => [...toScreen(view, step.x, step.y), step]), last = steps.slice(-1);
  ctx.strokeStyle = ctx.fillStyle = person.colour;
  fillCircles(ctx, view, steps.map(([sx, sy, step]) => [sx, sy, step.most]), plain ? 0.12 : 0.05);
  fillCircles(ctx, view, steps.map(([sx, sy, step]) => [sx, sy, step.half]), plain ? 0.3 : 0.2);
  ctx.lineWidth = plain ? 1 : 0.7; ctx.globalAlpha = plain ? 0.8 : 0.45;
  (plain ? steps : last).forEach(([sx, sy, step]) => [step.half, step.most].forEach((radius) => {
    ctx.beginPath(); ctx.arc(sx, sy, radius * view.scale, 0, TURN); ctx.stroke();
  }));
  ctx.globalAlpha = 0.9; ctx.lineWidth = plain ? 1.8 : 1.2; ctx.setLineDash([4, 3]);
  ctx.beginPath(); ctx.moveTo(...toScreen(view, state.x, state.y));
  steps.forEach(([sx, sy]) => ctx.lineTo(sx, sy));
  ctx.stroke(); ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}

// The path ahead alone.
function drawCourse(ctx, view, person, state, fan) {
  ctx.strokeStyle = person.colour; ctx.lineWidth = 1; ctx.beginPath(); ctx.moveTo(...toScreen(view, state.x, state.y));
  fan.steps.forEach((step) => ctx.lineTo(...toScreen(view, step.x, step.y)));
  ctx.stroke();
}

// From the one who looks to what is looked at: as opaque as it is probable.
function drawLooks(ctx, view, looks, state, theme, strong) {
  const here = toScreen(view, state.x, state.y);
  ctx.strokeStyle = theme.head; ctx.lineWidth = strong ? 2.4 : 1.6; ctx.lineCap = "round";
  looks.forEach((look) => {
    const there = toScreen(view, look.x, look.y), far = Math.hypot(there[0] - here[0], there[1] - here[1]);
    if (far < 1) return;
    const end = Math.max(1 - 8 / far, 0);
    ctx.globalAlpha = look.p;
    ctx.beginPath(); ctx.moveTo(...here); ctx.lineTo(here[0] + end * (there[0] - here[0]), here[1] + end * (there[1] - here[1])); ctx.stroke();
  });
  ctx.globalAlpha = 1; ctx.lineCap = "butt";
}

// What lies under the people: places, fans, hulls, looks.
function drawBehaviour(ctx, view, scene, present) {
  const { behaviour, layers, theme, time, people } = scene;
  if (layers.places) drawPlaces(ctx, view, behaviour.places, theme);
  if (layers.fans) {
    present.forEach(({ person, state, strong }) => {
      const fan = fanAt(behaviour, person, time);
      if (!fan) return;
      if (strong || present.length <= CROWD) drawFan(ctx, view, person, state, fan, strong || present.length <= FEW);
      else drawCourse(ctx, view, person, state, fan);
    });
  }
  if (layers.groups) drawGroups(ctx, view, groupsAt(behaviour, present, time), present.length > CROWD);
  if (layers.looks) present.forEach(({ person, state, strong }) => drawLooks(ctx, view, looksOf(behaviour, people, person, state, time), state, theme, strong));
  if (layers.places) drawPlaceNames(ctx, view, behaviour.places, theme);
}
