// Starts the replay and draws the charts once the page is there.

function readJson(element) { return JSON.parse(element.textContent); }

function themeChart(layout, root) {
  const style = getComputedStyle(root);
  const colour = (name) => style.getPropertyValue("--" + name).trim();
  const bar = { bgcolor: "rgba(0,0,0,0)", color: colour("muted"), activecolor: colour("ink") };
  const themed = { modebar: bar, ...layout, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { ...layout.font, color: colour("ink") } };
  Object.keys(layout).filter((key) => /^[xy]axis/.test(key)).forEach((key) => {
    themed[key] = { ...layout[key], gridcolor: colour("grid"), zerolinecolor: colour("grid"), linecolor: colour("muted") };
  });
  return themed;
}

function startChart(root, replay) {
  const figures = readJson(root.querySelector('script[type="application/json"]'));
  const plot = root.querySelector(".plot"), choice = root.querySelector("select");
  // The buttons are named one by one: by default plotly offers to send the data to a server of its makers.
  const config = {
    responsive: true, displayModeBar: "time" in root.dataset, displaylogo: false, showSendToCloud: false, plotlyServerURL: "",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
  };
  const ink = () => getComputedStyle(root).getPropertyValue("--ink").trim();
  function show() {
    const figure = figures[choice ? choice.selectedIndex : 0];
    // Truth is drawn in the colour of the text, which depends on the theme.
    const traces = figure.data.map((trace) => (trace.meta === "truth" ? { ...trace, line: { ...trace.line, color: ink() } } : trace));
    return Plotly.react(plot, traces, themeChart(figure.layout, root), config);
  }
  show().then(() => {
    if (replay && "time" in root.dataset) plot.on("plotly_click", (event) => replay.seek(event.points[0].x));
  });
  if (choice) choice.addEventListener("change", show);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", show);
}

const replayRoot = document.querySelector(".replay");
const replay = replayRoot ? startReplay(replayRoot, readJson(document.getElementById("replay-data"))) : null;
document.querySelectorAll(".chart").forEach((root) => startChart(root, replay));
