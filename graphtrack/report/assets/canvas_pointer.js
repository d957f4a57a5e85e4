// What a pointer does on a canvas: a drag moves, ctrl + wheel zooms, a double click fits. A finger scrolls the page.

function dragCanvas(canvas, actions) {
  let held = null, travelled = 0;
  canvas.addEventListener("pointerdown", (event) => {
    travelled = 0;
    if (event.pointerType !== "mouse" || event.button !== 0) return;
    held = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    const dx = event.clientX - held[0], dy = event.clientY - held[1];
    travelled += Math.abs(dx) + Math.abs(dy);
    held = [event.clientX, event.clientY];
    actions.moved(dx, dy);
  });
  ["pointerup", "pointercancel"].forEach((name) => canvas.addEventListener(name, () => { held = null; }));
  // The end of a drag is no click.
  canvas.addEventListener("click", (event) => { if (travelled > 4) event.stopImmediatePropagation(); });
  canvas.addEventListener("dblclick", actions.fit);
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return;  // a plain wheel scrolls the page
    event.preventDefault();
    actions.zoomed(Math.exp(-event.deltaY / 300), event.offsetX, event.offsetY);
  }, { passive: false });
}

// Text next to the pointer, kept within the canvas.
function placeTip(tip, canvas, sx, sy, words) {
  tip.hidden = !words;
  if (!words) return;
  tip.textContent = words;
  const left = Math.min(sx + 14, canvas.clientWidth - tip.offsetWidth - 4);
  tip.style.left = Math.max(left, 4) + "px";
  tip.style.top = (sy + 18 + tip.offsetHeight > canvas.clientHeight ? sy - tip.offsetHeight - 8 : sy + 18) + "px";
}
