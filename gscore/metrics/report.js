// Comforts of report.html: switches, values under the mouse, flipping and enlarging pictures.
"use strict";

function press(button) {
  for (const other of button.parentElement.querySelectorAll("button")) {
    other.setAttribute("aria-pressed", String(other === button));
  }
}

for (const button of document.querySelectorAll("button[data-axis]")) {
  button.addEventListener("click", () => {
    press(button);
    document.getElementById("curves").dataset.axis = button.dataset.axis;
  });
}

for (const button of document.querySelectorAll("button[data-order]")) {
  button.addEventListener("click", () => {
    press(button);
    const cards = document.getElementById("cards");
    // A view without a number is identical to its photo: the best, so last.
    const worth = (card) => (card.dataset.psnr === "" ? Infinity : Number(card.dataset.psnr));
    const by = button.dataset.order === "psnr" ? worth : (card) => Number(card.dataset.number);
    cards.append(...[...cards.children].sort((a, b) => by(a) - by(b)));
  });
}

for (const chart of document.querySelectorAll("svg.chart[data-hover]")) {
  const points = JSON.parse(chart.dataset.hover);
  const cursor = chart.querySelector(".cursor");
  const [line, circle, text] = cursor.children;
  const { width, height } = chart.viewBox.baseVal;
  chart.addEventListener("pointermove", (event) => {
    const box = chart.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * width;
    const y = ((event.clientY - box.top) / box.height) * height;
    const far = (p) => Math.abs(p[0] - x) + 0.2 * Math.abs(p[1] - y);
    const [px, py, words] = points.reduce((a, b) => (far(b) < far(a) ? b : a));
    line.setAttribute("x1", px);
    line.setAttribute("x2", px);
    line.setAttribute("y1", 14);
    line.setAttribute("y2", height - 36);
    circle.setAttribute("cx", px);
    circle.setAttribute("cy", py);
    text.textContent = words;
    const right = px > width / 2;
    text.setAttribute("x", px + (right ? -8 : 8));
    text.setAttribute("y", Math.max(24, py - 10));
    text.setAttribute("text-anchor", right ? "end" : "start");
    cursor.setAttribute("visibility", "visible");
  });
  chart.addEventListener("pointerleave", () => cursor.setAttribute("visibility", "hidden"));
}

for (const render of document.querySelectorAll("img.render")) {
  const own = render.src;
  const photo = render.closest(".triple").querySelector("img.photo").src;
  // A finger enters a picture too, but leaves it only when it touches another.
  render.addEventListener("pointerenter", (event) => {
    if (event.pointerType === "mouse") render.src = photo;
  });
  render.addEventListener("pointerleave", () => (render.src = own));
}

const viewer = document.getElementById("viewer");
if (viewer) {
  const kinds = ["photo", "render", "error"];
  let card = null;
  let kind = "render";
  const show = (nextCard, nextKind) => {
    card = nextCard;
    kind = nextKind;
    viewer.hidden = false;
    viewer.querySelector("img").src = card.sources[kind];
    viewer.querySelector("b").textContent = card.words;
    press(viewer.querySelector(`[data-show="${kind}"]`));
  };
  const cards = [...document.querySelectorAll("article")].map((article) => ({
    article,
    words: `${article.dataset.name}   ${article.querySelector("p").textContent}`,
    sources: Object.fromEntries(kinds.map((k) => [k, article.querySelector(`img.${k}`).src])),
  }));
  for (const one of cards) {
    for (const k of kinds) {
      one.article.querySelector(`img.${k}`).addEventListener("click", () => show(one, k));
    }
  }
  const go = (step) => {
    const order = [...document.querySelectorAll("article")];
    const next = order[order.indexOf(card.article) + step];
    if (next) show(cards.find((c) => c.article === next), kind);
  };
  for (const button of viewer.querySelectorAll("button")) {
    button.addEventListener("click", (event) => {
      event.stopPropagation();
      if (button.dataset.go) go(Number(button.dataset.go));
      else if (button.dataset.show === "close") viewer.hidden = true;
      else show(card, button.dataset.show);
    });
  }
  viewer.addEventListener("click", () => (viewer.hidden = true));
  document.addEventListener("keydown", (event) => {
    if (viewer.hidden) return;
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const turn = { ArrowRight: 1, ArrowLeft: 2, " ": 1 }[event.key];
    if (event.key === "Escape") viewer.hidden = true;
    else if (turn) show(card, kinds[(kinds.indexOf(kind) + turn) % 3]);
    else if (step) go(step);
    else return;
    event.preventDefault();
  });
}
