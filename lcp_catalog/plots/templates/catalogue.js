// Sorts the cards of the points by the chosen figure.
document.getElementById('order')?.addEventListener('change', event => {
  const box = document.getElementById('cards'), key = event.target.value;
  [...box.children].sort((a, b) => a.dataset[key] - b.dataset[key]).forEach(card => box.append(card));
});
