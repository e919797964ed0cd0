// The table of cases: sorted by a click on a heading, and only those rows that are asked for.
(() => {
  const table = document.getElementById('case-table'), body = table.tBodies[0], rows = [...body.rows];
  const form = document.querySelector('form.filter'), find = document.getElementById('find'), planner = document.getElementById('planner');
  const shown = document.getElementById('shown'), whole = shown.textContent;
  const reasons = new Map();
  for (const one of JSON.parse(document.getElementById('tubeplan-cohort').textContent).cases) reasons.set(one.id, `${one.id} ${one.reason ?? ''} ${one.method}`.toLowerCase());

  const value = (row, k) => { // a figure, a rank, otherwise text; nothing for a dash
    const cell = row.cells[k], figure = cell.querySelector('data'), text = cell.textContent.trim();
    return figure ? Number(figure.value) : cell.dataset.sort !== undefined ? Number(cell.dataset.sort) : text === '–' ? null : text;
  };
  const compare = (a, b) => (typeof a === 'number' && typeof b === 'number' ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true }));

  [...table.tHead.rows[0].cells].forEach((head, k) => {
    const button = document.createElement('button');
    button.type = 'button'; button.textContent = head.textContent; head.replaceChildren(button);
    button.addEventListener('click', () => {
      const was = head.getAttribute('aria-sort');
      for (const other of table.tHead.rows[0].cells) other.removeAttribute('aria-sort');
      if (was === 'descending') { body.append(...rows); return; } // a third click: the manifest's order again
      const sign = was === 'ascending' ? -1 : 1;
      head.setAttribute('aria-sort', sign > 0 ? 'ascending' : 'descending');
      const keyed = rows.map((row) => [value(row, k), row]);
      keyed.sort(([a], [b]) => (a === null ? (b === null ? 0 : 1) : b === null ? -1 : sign * compare(a, b))); // what has none stays last
      body.append(...keyed.map(([, row]) => row));
    });
  });

  const filter = () => {
    const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
    const boxes = [...form.querySelectorAll('input[name=status]')];
    const wanted = new Set(boxes.filter((box) => box.checked).map((box) => box.value));
    let count = 0;
    for (const row of rows) {
      const text = reasons.get(row.cells[0].textContent.trim());
      const fits = words.every((word) => text.includes(word)) && (!boxes.length || wanted.has(row.dataset.status)) && (!planner || !planner.value || planner.value === row.dataset.planner);
      row.hidden = !fits; count += fits;
    }
    shown.textContent = count === rows.length ? whole : `${count} of ${rows.length} cases are shown.`;
  };
  form.addEventListener('input', filter);
  form.addEventListener('submit', (event) => event.preventDefault());
  form.addEventListener('reset', () => setTimeout(filter));
})();
