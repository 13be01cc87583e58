// Marks the page as scripted, moves the swipe, and sorts tables by the column clicked.
document.documentElement.classList.add('scripted');
document.querySelectorAll('.swipe').forEach(swipe => swipe.addEventListener('input', () =>
  swipe.parentNode.style.setProperty('--cut', swipe.value + '%')));
document.querySelectorAll('.sortable').forEach(table => {
  const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  const key = (row, k) => {
    const text = row.cells[k].textContent, value = parseFloat(text);
    return Number.isNaN(value) ? (text === '–' ? null : text) : value;
  };
  // rows without a value come last in both directions
  const compare = (a, b, sign) => a === null ? (b === null ? 0 : 1) : b === null ? -1 :
    (a < b ? -1 : a > b ? 1 : 0) * sign;
  heads.forEach((head, k) => head.firstChild.addEventListener('click', () => {
    const up = head.getAttribute('aria-sort') !== 'ascending';
    heads.forEach(one => one.removeAttribute('aria-sort'));
    head.setAttribute('aria-sort', up ? 'ascending' : 'descending');
    [...body.rows].map(row => [key(row, k), row])
      .sort((a, b) => compare(a[0], b[0], up ? 1 : -1)).forEach(pair => body.append(pair[1]));
  }));
});
