// Interaction of report.html: the order of views, flipping and enlarging pictures.

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

for (const render of document.querySelectorAll("img.render")) {
  const own = render.src;
  const photo = render.closest(".triple").querySelector("img.photo").src;
  // Touch enters a picture too, but leaves it only when it touches another.
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
