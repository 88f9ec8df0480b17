// Common to all pages with curves: switches, the axis of curves, values under the mouse.
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
