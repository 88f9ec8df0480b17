// Interaction of the comparison: sliders, the pictures on their sides, the order of views.

for (const slider of document.querySelectorAll(".slider")) {
  const range = slider.querySelector("input");
  const put = (share) => {
    range.value = String(100 * Math.min(1, Math.max(0, share)));
    slider.style.setProperty("--at", `${range.value}%`);
  };
  const follow = (event) => {
    const box = slider.getBoundingClientRect();
    put((event.clientX - box.left) / box.width);
  };
  slider.addEventListener("pointerdown", (event) => {
    slider.setPointerCapture(event.pointerId);
    follow(event);
  });
  slider.addEventListener("pointermove", (event) => {
    if (event.buttons || event.pointerType === "mouse") follow(event);
  });
  range.addEventListener("input", () => put(Number(range.value) / 100));
}

for (const button of document.querySelectorAll("button[data-sides]")) {
  button.addEventListener("click", () => {
    press(button);
    document.getElementById("views").dataset.sides = button.dataset.sides;
  });
}

for (const button of document.querySelectorAll("button[data-order]")) {
  button.addEventListener("click", () => {
    press(button);
    const cards = document.getElementById("cards");
    const sign = { name: 0, loss: 1, gain: -1 }[button.dataset.order];
    const change = (card) => sign * Number(card.dataset.change);
    const place = (card) => Number(card.dataset.number);
    cards.append(...[...cards.children].sort((a, b) => change(a) - change(b) || place(a) - place(b)));
  });
}
