// The few things the page does with its document. Texts go in as text, never as markup.
export const byId = (id) => document.getElementById(id);

export function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name === "class") element.className = value;
    else if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== null && value !== undefined && value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Sets the text only where it differs: no layout, no lost selection. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function icon(name) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("aria-hidden", "true");
  const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  use.setAttribute("href", `/static/icons.svg#${name}`);
  svg.append(use);
  return svg;
}

export function setIcon(svg, name) {
  const use = svg.querySelector("use");
  const href = `/static/icons.svg#${name}`;
  if (use.getAttribute("href") !== href) use.setAttribute("href", href);
}

/**
 * Brings a table to the rows given; rows stay the same elements while their key stays, so focus and selection survive.
 * columns: [{head, class}]; rows: [{key, class, cells: [text or Node]}].
 */
export function fillTable(table, columns, rows, empty) {
  if (!table.tHead || table.tHead.rows[0].cells.length !== columns.length) {
    table.setAttribute("role", "table"); // roles by name: on a phone rows are shown one under the other, and a browser may forget that this is a table
    table.replaceChildren(make("thead", { role: "rowgroup" }, make("tr", { role: "row" },
      ...columns.map((column) => make("th", { scope: "col", role: "columnheader", class: column.class ?? "" })))), make("tbody", { role: "rowgroup" }));
  }
  columns.forEach((column, index) => say(table.tHead.rows[0].cells[index], column.head));
  const body = table.tBodies[0];
  if (!rows.length) {
    body.replaceChildren(make("tr", { role: "row" }, make("td", { role: "cell", colspan: columns.length, class: "empty" }, empty)));
    return;
  }
  const known = new Map([...body.rows].map((row) => [row.dataset.key, row]));
  const wanted = rows.map((row) => {
    const element = known.get(String(row.key)) ?? make("tr", { role: "row", "data-key": row.key },
      ...columns.map((column) => make("td", { role: "cell", class: column.class ?? "", "data-head": column.head })));
    if (element.className !== (row.class ?? "")) element.className = row.class ?? "";
    row.cells.forEach((cell, index) => {
      if (cell instanceof Node) { if (element.cells[index].firstChild !== cell) element.cells[index].replaceChildren(cell); }
      else say(element.cells[index], String(cell ?? ""));
    });
    return element;
  });
  const same = body.rows.length === wanted.length && wanted.every((row, index) => body.rows[index] === row);
  if (!same) body.replaceChildren(...wanted);
}
