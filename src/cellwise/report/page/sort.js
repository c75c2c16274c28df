// A click on the head of a column puts the rows of a table in its order; again, the other way round.
"use strict";
for (const table of document.querySelectorAll("table.sort")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  const text = (row, k) => row.cells[k].textContent.trim();
  const number = (row, k) => parseFloat(text(row, k).replace("\u2212", "-").replace(/\s/g, ""));
  heads.forEach((head, k) => {
    head.tabIndex = 0;
    const sort = () => {
      const down = head.getAttribute("aria-sort") !== "descending";
      for (const one of heads) one.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const numbers = head.classList.contains("n");
      const order = (a, b) => numbers ? number(b, k) - number(a, k)
        : text(b, k).localeCompare(text(a, k));
      const known = (row) => !numbers || !Number.isNaN(number(row, k));
      const rows = [...body.rows], sorted = rows.filter(known).sort(order);
      if (!down) sorted.reverse();
      body.append(...sorted, ...rows.filter((row) => !known(row)));  // what is not known is last
    };
    head.addEventListener("click", sort);
    head.addEventListener("keydown", (event) => { if (event.key === "Enter") sort(); });
  });
}
