// Shows the objects of one state, and those whose name holds what was typed. Without this script the page shows all objects.
"use strict";
const tools = document.getElementById("tools");
const search = document.getElementById("search");
const cards = Array.from(document.querySelectorAll(".card"));

function choose() {
  const show = tools.elements.show.value;
  const typed = search.value.trim().toLowerCase();
  let shown = 0;
  for (const card of cards) {
    const inGroup = show === "all" || card.dataset.group === show || (show === "warnings" && "warnings" in card.dataset);
    card.hidden = !(inGroup && card.dataset.name.toLowerCase().includes(typed));
    shown += !card.hidden;
  }
  for (const section of document.querySelectorAll("section")) {
    section.hidden = !section.querySelector(".card:not([hidden])");
  }
  document.getElementById("found").textContent = shown === cards.length ? "" : shown + " of " + cards.length;
  document.getElementById("nothing").hidden = shown > 0 || cards.length === 0;
}

tools.hidden = false;
tools.addEventListener("input", choose);
tools.addEventListener("submit", (event) => event.preventDefault());
document.addEventListener("keydown", (event) => {
  if (event.key === "/" && document.activeElement !== search) {
    event.preventDefault();
    search.focus();
  }
});
addEventListener("hashchange", () => {
  // a link to a group must not lead to what is hidden
  tools.elements.show.value = "all";
  search.value = "";
  choose();
  document.getElementById(location.hash.slice(1))?.scrollIntoView();
});
choose(); // browsers keep what was chosen when a page is loaded again
