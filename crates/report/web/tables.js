/** Makes score tables sortable: click, Enter or Space on a column head; again to reverse. */
export function makeTablesSortable(root) {
  for (const table of root.querySelectorAll("table.scores")) {
    const rows = table.tHead ? [...table.tHead.rows] : [];
    const last = rows[rows.length - 1];
    if (!last || !table.tBodies.length) continue;
    [...last.cells].forEach((cell, column) => makeHeadSortable(table, cell, column));
  }
}

function makeHeadSortable(table, cell, column) {
  const button = document.createElement("button");
  button.type = "button";
  button.className = "sort";
  button.textContent = cell.textContent || "↕";
  button.setAttribute("aria-label", `sort by ${cell.textContent || "this column"}`);
  cell.replaceChildren(button);
  button.addEventListener("click", () => sortTable(table, cell, column));
}

function sortTable(table, cell, column) {
  const rising = cell.getAttribute("aria-sort") !== "ascending";
  for (const other of cell.parentElement.cells) other.removeAttribute("aria-sort");
  cell.setAttribute("aria-sort", rising ? "ascending" : "descending");
  const key = (row) => {
    const text = row.cells[column]?.textContent.trim() ?? "";
    const number = Number(text.replace(/[,\s]/g, "").replace("−", "-").replace(/[*†]$/, ""));
    return text === "" || Number.isNaN(number) ? text : number;
  };
  const before = (a, b) => {
    const [x, y] = [key(a), key(b)];
    if (typeof x !== typeof y) return typeof x === "number" ? -1 : 1; // values that are not numbers come last
    const order = typeof x === "number" ? x - y : x.localeCompare(y);
    return rising ? order : -order;
  };
  const body = table.tBodies[0];
  body.append(...[...body.rows].sort(before));
}
