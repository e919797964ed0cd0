// Labels of the 3D scene: two columns beside their places, never over each other, each with a leader.
const NS = 'http://www.w3.org/2000/svg';
const GAP = 26;

export function createLabels(host, svg, labels) {
  const items = labels.map((label) => {
    const plate = document.createElement('b');
    plate.className = label.kind;
    plate.textContent = label.text;
    host.append(plate);
    const leader = document.createElementNS(NS, 'line');
    leader.setAttribute('class', `leader ${label.kind}`);
    svg.append(leader);
    return { ...label, plate, leader, width: 0 };
  });
  return (project, width, height) => {
    const low = 18, high = height - 86; // the scale and the corner mark stand below
    for (const item of items) {
      [item.x, item.y] = project(item.point);
      item.width ||= item.plate.offsetWidth;
      item.seen = item.x > 0 && item.x < width && item.y > 0 && item.y < height;
      item.plate.hidden = !item.seen;
      item.leader.style.display = item.seen ? '' : 'none';
    }
    const shown = items.filter((item) => item.seen);
    const sorted = shown.map((item) => item.x).sort((a, b) => a - b);
    const middle = sorted.length ? sorted[sorted.length >> 1] : 0;
    for (const left of [true, false]) {
      const side = shown.filter((item) => (item.x < middle || (item.x === middle && item.x < width / 2)) === left).sort((a, b) => a.y - b.y);
      side.forEach((item, k) => { item.at = Math.max(item.y, k ? side[k - 1].at + GAP : low); });
      for (let k = side.length - 1; k >= 0; k--) side[k].at = Math.min(side[k].at, k === side.length - 1 ? high : side[k + 1].at - GAP);
      for (const item of side) {
        const edge = left ? Math.max(item.width + 6, item.x - 34) : Math.min(width - item.width - 6, item.x + 34);
        const box = left ? edge - item.width : edge;
        item.plate.style.transform = `translate(${box.toFixed(1)}px, ${(item.at - 12).toFixed(1)}px)`;
        for (const [name, value] of [['x1', item.x], ['y1', item.y], ['x2', edge], ['y2', item.at]]) item.leader.setAttribute(name, value.toFixed(1));
      }
    }
  };
}
