"use strict";
const EVERY = 2000; // ms
const part = (name) => document.getElementById(name);
const WORDS = {
  running: "works now",
  finished: "is finished",
  stopped: "was stopped; the same command goes on",
  lost: "was killed; the same command goes on",
  failed: "ended by an error, see below; the same command goes on",
};

const two = (number) => String(number).padStart(2, "0");

function duration(seconds) {
  const all = Math.round(seconds), hours = Math.floor(all / 3600);
  const rest = `${Math.floor(all / 60) % 60}`;
  return hours ? `${hours}:${two(rest)}:${two(all % 60)}` : `${rest}:${two(all % 60)}`;
}

const clock = (date) => `${two(date.getHours())}:${two(date.getMinutes())}`;

function fact(name, text) {
  part(name).textContent = text || "–";
}

// Text alone is put into the page, so nothing that a run says can be taken for HTML.
function cell(row, text) {
  row.appendChild(document.createElement("td")).textContent = text;
}

function finalists(entries) {
  const body = part("finalists");
  body.replaceChildren();
  part("final").hidden = !entries.length;
  for (const entry of entries) {
    const row = body.insertRow();
    if (entry.best) row.className = "best";
    cell(row, entry.title);
    cell(row, entry.figure || "being rendered");
    cell(row, entry.interval || "");
    cell(row, entry.gain || "–");
  }
}

function show(night) {
  part("problem").hidden = !night.error;
  part("problem").textContent = night.error;
  if (night.error) return;
  const state = WORDS[night.state] || night.state;
  if (part("state").textContent !== state) part("state").textContent = state;
  const share = night.state === "finished" ? 1 : night.share;
  const percent = `${Math.round(100 * share)} %`;
  part("stage").textContent = night.state === "finished" ? "All stages are done" : night.stage || "Beginning";
  part("share").value = share;
  part("share").setAttribute("aria-valuetext", percent);
  part("percent").textContent = percent;
  const left = night.eta_seconds;
  fact("left", left === null ? "" : `${duration(left)}, until about ${clock(new Date(Date.now() + 1000 * left))}`);
  fact("best", night.best_words);
  fact("renders", `${night.evaluations} in ${duration(night.render_seconds)} of rendering`);
  fact("worked", `${duration(night.seconds)} in ${night.attempts} ${night.attempts === 1 ? "attempt" : "attempts"}`);
  fact("holder", night.holder);
  finalists(night.finalists);
  const log = part("log"), lines = night.log.join("\n");
  if (log.textContent !== lines) {
    log.textContent = lines;
    log.scrollTop = log.scrollHeight;
  }
  part("report").hidden = !night.report;
  document.title = night.state === "running" ? `${percent}, ${night.stage}` : `${part("run").textContent} ${state}`;
}

async function ask() {
  try {
    const answer = await fetch("status.json", { cache: "no-store" });
    show(await answer.json());
    part("seen").textContent = `Asked at ${clock(new Date())}, again every ${EVERY / 1000} s.`;
    part("silent").hidden = true;
  } catch {
    part("silent").hidden = false;
  }
  setTimeout(ask, EVERY);
}

ask();
