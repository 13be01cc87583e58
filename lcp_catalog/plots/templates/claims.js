// Draws the points' claims for the chosen Sun, view and image scale (data: catalog/claim_map.py).
(() => {
  const given = JSON.parse(document.getElementById('numbers').textContent);
  const bytes = Uint8Array.from(atob(given.data), letter => letter.charCodeAt(0));
  const count = given.points.length, suns = given.suns.length, views = given.views.length;
  const scales = given.scales.length, plane = count * scales * views * suns;
  const ROWS = 100, UNKNOWN = 255, COLOURS = 6;
  const form = document.getElementById('choices').elements;
  const cells = [...document.querySelectorAll('#sky use')];

  const claim = (point, scale, view, sun) => {
    const flags = bytes[(point * views + view) * suns + sun];
    const at = count * views * suns + ((point * scales + scale) * views + view) * suns + sun;
    const [detection, size, shape, angle] = [0, 1, 2, 3].map(k => bytes[at + k * plane]);
    const probability = detection === UNKNOWN ? NaN : detection / 250;
    const major = size === UNKNOWN ? NaN : given.sigma_m * given.sigma_ratio ** size;
    const free = (flags & 25) === 25;
    const works = scale === 0 ? (flags & 31) === 31 : free && probability >= given.least - 0.002;
    return {point, probability, works, major, minor: major * shape / 254, angle, evaluated: flags & 1};
  };
  const shade = share => 'c' + Math.min(COLOURS - 1, Math.floor(share * (COLOURS - 1) + 0.5));
  const short = metres => metres >= 100 ? metres.toFixed(0) : metres.toPrecision(2);
  const option = (value, text) => `<option value="${value}">${text}</option>`;
  const chosen = {sun: given.first[1], view: given.first[0], scale: 0};

  const dot = found => {
    const [, , , x, y, , north] = given.points[found.point];
    const text = `${given.points[found.point][0]}: probability ${found.probability.toFixed(2)}`;
    const css = `${shade(found.probability)}${found.works ? '' : ' weak'}`;
    const circle = `<circle class="${css}" cx="${x}" cy="${y}" r="${found.works ? 4.2 : 3.2}"><title>${text}</title></circle>`;
    if (!found.works) return circle;
    const [a, b] = [found.major, found.minor].map(m => (m * given.px_per_m * given.enlarged).toFixed(1));
    const ring = css => `<ellipse${css} rx="${b}" ry="${a}" transform="translate(${x} ${y}) rotate(${found.angle + north})"/>`;
    return ring(' class="shade"') + ring('') + circle;
  };
  const row = found => {
    const [name, lon, lat] = given.points[found.point];
    const ellipse = `${short(found.major)} × ${short(found.minor)}`;
    return `<tr><td>${name}</td><td>${lon.toFixed(4)}</td><td>${lat.toFixed(4)}</td>` +
      `<td>${found.probability.toFixed(2)}</td><td>${ellipse}</td><td>${found.angle}</td></tr>`;
  };
  const outcome = (found, good) => {
    const sigmas = good.map(one => one.major).sort((a, b) => a - b);
    const middle = sigmas.length ? `, median sigma ${short(sigmas[Math.floor(sigmas.length / 2)])} m` : '';
    return `<strong>${good.length} of ${found.length}</strong> points are usable${middle}.`;
  };
  const draw = () => {
    const all = given.points.map((_, k) => claim(k, chosen.scale, chosen.view, chosen.sun));
    const found = all.filter(one => one.evaluated && !Number.isNaN(one.probability));
    found.sort((a, b) => b.probability - a.probability || a.major - b.major);
    const good = found.filter(one => one.works);
    document.getElementById('claims').innerHTML = [...found].reverse().map(dot).join('');
    document.getElementById('found').innerHTML = good.slice(0, ROWS).map(row).join('');
    document.getElementById('outcome').innerHTML = outcome(found, good);
    document.getElementById('more').textContent =
      good.length > ROWS ? `The ${ROWS} most probable of ${good.length} usable points.` : '';
    cells.forEach((cell, sun) => {
      const seen = given.points.map((_, k) => claim(k, chosen.scale, chosen.view, sun)).filter(one => one.evaluated);
      const share = seen.length ? seen.filter(one => one.works).length / seen.length : 0;
      cell.setAttribute('class', shade(share) + (sun === chosen.sun ? ' chosen' : ''));
      const [i, j] = given.suns[sun];
      cell.querySelector('title').textContent =
        `azimuth ${given.azimuths[j]}°, elevation ${given.elevations[i]}°: ${(100 * share).toFixed(0)} %`;
    });
  };
  const lists = () => {
    const [row, column] = given.suns[chosen.sun];
    const rows = [...new Set(given.suns.map(sun => sun[0]))];
    const columns = given.suns.filter(sun => sun[0] === row).map(sun => sun[1]);
    form.elevation.innerHTML = rows.map(i => option(i, `${given.elevations[i]}°`)).join('');
    form.azimuth.innerHTML = columns.map(j => option(j, `${given.azimuths[j]}°`)).join('');
    [form.elevation.value, form.azimuth.value] = [row, column];
  };
  const choose = sun => { chosen.sun = sun; lists(); draw(); };
  const nearest = (row, column) => {
    const away = j => Math.abs((given.azimuths[j] - given.azimuths[column] + 540) % 360 - 180);
    const there = given.suns.map((sun, k) => [sun, k]).filter(pair => pair[0][0] === row);
    return there.reduce((best, pair) => away(pair[0][1]) < away(best[0][1]) ? pair : best)[1];
  };
  form.view.innerHTML = given.views.map((name, k) => option(k, name)).join('');
  const cell = given.points[0][5];
  form.scale.innerHTML = given.scales.map((s, k) =>
    option(k, s === 1 ? 'the patch’s cell or finer' : `${s} cells (${short(s * cell)} m)`)).join('');
  form.view.addEventListener('change', () => { chosen.view = +form.view.value; draw(); });
  form.scale.addEventListener('change', () => { chosen.scale = +form.scale.value; draw(); });
  for (const name of ['elevation', 'azimuth']) {
    form[name].addEventListener('change', () => choose(nearest(+form.elevation.value, +form.azimuth.value)));
  }
  cells.forEach((cell, sun) => cell.addEventListener('click', () => choose(sun)));
  document.getElementById('chooser').hidden = false;
  choose(chosen.sun);
})();
