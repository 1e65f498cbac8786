"use strict";
// Sorts a table by the column whose heading is clicked; what has no figure stays at the end.
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  if (body.rows.length) {
    const save = document.createElement("button");
    save.type = "button";
    save.className = "save screen";
    save.textContent = "CSV";
    save.title = document.body.dataset.save ?? "Save this table as a CSV file";
    save.addEventListener("click", () => {
      // An apostrophe before what a spreadsheet would take for a formula, unless it is a number.
      const field = (text) => `"${text.replace(/^(?![+-]?[\d.,]+$)(?=[=+@\t\r-])/, "'").replaceAll('"', '""')}"`;
      const lines = [...table.rows].map((row) => [...row.cells].map((cell) => field(cell.textContent.trim())).join(","));
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob(["\ufeff", lines.join("\r\n"), "\r\n"], { type: "text/csv" }));
      link.download = `${(table.caption ?? table.closest("section")?.querySelector("h2"))?.textContent.trim() ?? "table"}.csv`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
    table.parentElement.after(save);
  }
  [...table.tHead.rows[0].cells].forEach((head, column) => {
    head.firstChild.addEventListener("click", () => {
      const now = head.getAttribute("aria-sort");
      const rising = now ? now === "descending" : head.dataset.first === "rising";
      for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", rising ? "ascending" : "descending");
      const keyed = [...body.rows].map((row) => [row.cells[column].dataset.key, row]);
      const numeric = keyed.every(([key]) => key === "" || Number.isFinite(Number(key)));
      const order = (a, b) => (numeric ? Number(a) - Number(b) : a < b ? -1 : a > b ? 1 : 0);
      keyed.sort(([a], [b]) => (a === "" || b === "" ? (a === "") - (b === "") : rising ? order(a, b) : order(b, a)));
      body.append(...keyed.map(([, row]) => row));
    });
  });
}
