// Starts the tables, then unpacks the data and starts what is drawn from them.

const tables = [...document.querySelectorAll(".panel table")];
const turning = tables.map(startTable);

async function startDrawing() {
  const root = document.querySelector(".replay"), holder = document.getElementById("replay-data");
  if (!root) return;
  let data;
  try {
    data = await unpack(holder.textContent);
  } catch (error) {
    const trouble = root.querySelector('[data-part="trouble"]');
    const old = "This browser cannot unpack the data of the replay (Chrome 80, Firefox 113, Safari 16.4 and later can).";
    trouble.textContent = typeof DecompressionStream === "undefined" ? old : "The data of the replay are damaged: " + error.message;
    trouble.hidden = false;
    return;
  }
  const crowd = createCrowd(data.people.map((coded) => decodePerson(coded, data.steps)));
  const events = decodeEvents(data.events, crowd.people);
  const behaviour = decodeBehaviour(data, crowd.people);
  const replay = startReplay(root, crowd, data.frame || 0, data.unsure, events, behaviour, data.sensors, data.background);
  startPeople(root, crowd, replay);
  tellDoing(root.querySelector('[data-part="doing"]'), crowd, replay, behaviour);
  document.querySelectorAll(".angles").forEach((chart) => startAngles(chart, crowd, replay));
  document.querySelectorAll(".timeline").forEach((chart) => startTimeline(chart, crowd, replay, data.unsure, events));
  tables.forEach((table, i) => linkTable(table, turning[i], crowd, replay));
}

startDrawing();
