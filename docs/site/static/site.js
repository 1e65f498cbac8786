// Accessibility that the theme leaves open: headings of the navigation, names of both sidebars, regions that scroll, empty headings.
const articles = "article pre, article table.docutils";

function makeScrollingFocusable() {
  for (const region of document.querySelectorAll(articles)) {
    if (region.scrollWidth > region.clientWidth) region.tabIndex = 0;
    else region.removeAttribute("tabindex");
  }
}

function nameLandmarks() {
  for (const caption of document.querySelectorAll(".caption[role=heading]")) caption.setAttribute("aria-level", "2");
  document.querySelector(".sidebar-drawer")?.setAttribute("aria-label", "Pages");
  document.querySelector(".toc-drawer")?.setAttribute("aria-label", "On this page");
}

function removeEmptyHeadings() {
  for (const head of document.querySelectorAll("article thead")) if (!head.textContent.trim()) head.remove();
  for (const cell of document.querySelectorAll("article th")) {
    if (!cell.textContent.trim()) cell.replaceWith(document.createElement("td"));
  }
}

function titleSearch() {
  if (document.querySelector("h1") || !document.querySelector("#search-results")) return;
  const title = document.createElement("h1");
  title.textContent = "Search";
  document.querySelector("article").prepend(title);
}

document.addEventListener("DOMContentLoaded", () => {
  nameLandmarks();
  removeEmptyHeadings();
  titleSearch();
  makeScrollingFocusable();
});
addEventListener("load", makeScrollingFocusable);
addEventListener("resize", makeScrollingFocusable);
