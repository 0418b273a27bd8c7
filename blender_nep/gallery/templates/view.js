// Exposure, the light as background, and words if the model cannot be shown.
"use strict";
const viewer = document.getElementById("viewer");
const message = document.getElementById("message");
const exposure = document.getElementById("exposure");
const surroundings = document.getElementById("surroundings");
const start = Number(viewer.getAttribute("exposure") || 1);

viewer.addEventListener("load", () => {
  message.hidden = true;
  document.getElementById("tools").hidden = false;
});
viewer.addEventListener("error", () => {
  message.hidden = false;
  message.textContent = "The model cannot be shown here. Open asset.glb in another program.";
});
exposure.addEventListener("input", () => {
  const stops = Number(exposure.value);
  viewer.setAttribute("exposure", start * 2 ** stops);
  document.getElementById("stops").textContent = (stops > 0 ? "+" : "") + stops + " EV";
});
if (surroundings) {
  surroundings.addEventListener("input", () => {
    if (surroundings.checked) viewer.setAttribute("skybox-image", viewer.getAttribute("environment-image"));
    else viewer.removeAttribute("skybox-image");
  });
}
