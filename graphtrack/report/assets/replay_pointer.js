// Pointer in the replay: hovering shows a person's name, a click selects the person.

function startPointing(tip, canvas, crowd, replay) {
  let last = null, queued = false;
  function pick(sx, sy, grip) {
    const { time, trail, everything, reach } = replay.moment(), [x, y] = replay.ground(sx, sy);
    return pickPerson(crowd.people, x, y, time, trail, everything, reach * grip);
  }
  function doing(index) {
    const words = doingInWords(replay.behaviour, crowd.people, index, replay.moment().time);
    return words && " · " + words;
  }
  function together(sx, sy) {
    const { time, layers } = replay.moment();
    return layers.groups ? groupUnder(replay.behaviour, crowd.people, ...replay.ground(sx, sy), time) : "";
  }
  function point() {
    queued = false;
    const found = last && pick(last[0], last[1], 1), index = found ? found.index : -1;
    if (index !== crowd.hovered) { crowd.hovered = index; replay.redraw(); }
    canvas.style.cursor = found ? "pointer" : "";
    const away = found && Math.abs(found.time - replay.moment().time) > 0.05 ? " · here at " + found.time.toFixed(1) + " s" : "";
    placeTip(tip, canvas, last ? last[0] : 0, last ? last[1] : 0, found ? crowd.people[index].name + (away || doing(index)) : last ? together(last[0], last[1]) : "");
  }
  function later(at) {
    last = at;
    if (!queued) { queued = true; requestAnimationFrame(point); }
  }
  canvas.addEventListener("pointermove", (event) => {
    if (event.pointerType === "mouse") later(event.buttons ? null : [event.offsetX, event.offsetY]);
  });
  canvas.addEventListener("click", (event) => {
    const found = pick(event.offsetX, event.offsetY, event.pointerType === "touch" ? 2 : 1);
    crowd.choose(found ? found.index : -1);
    // On the path of a person absent at this time: go to the time of that point.
    if (found && !stateAt(crowd.people[found.index], replay.moment().time)) replay.seek(found.time);
  });
  return { leave: () => later(null) };
}
