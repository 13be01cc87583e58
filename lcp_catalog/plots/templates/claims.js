// The points under the chosen Sun, view, level and image scale (data: catalog/claim_map.py).
(async () => {
  const given = JSON.parse(document.getElementById('numbers').textContent);
  const unpacked = async text => {
    const packed = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('deflate'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };
  const element = id => document.getElementById(id);
  const [bytes, near, relief] = await Promise.all([given.data, given.cells.data, given.patches.data].map(unpacked));
  const count = given.points.length, suns = given.suns.length, views = given.views.length;
  const scales = given.scales.length, plane = count * scales * views * suns;
  const patchSide = given.patches.side, patchOf = new Map(given.patches.of.map((point, k) => [point, k]));
  const ROWS = 100, UNKNOWN = 255, COLOURS = 6, ELLIPSES = 3000, REACH_PX = 14;
  const EVALUATED = 1, LOCALIZABLE = 2, UNIQUE = 4, UNSHADOWED = 8, UNOCCLUDED = 16;
  const FREE = EVALUATED | UNSHADOWED | UNOCCLUDED, USABLE = FREE | LOCALIZABLE | UNIQUE;
  const WHY = [
    [UNSHADOWED, 'shadowed by terrain outside the patch'], [UNOCCLUDED, 'hidden by terrain outside the patch'],
    [LOCALIZABLE, 'too little texture'], [UNIQUE, 'similar to other terrain'],
  ];
  const form = element('choices').elements, sky = [...document.querySelectorAll('#sky use')];
  const rows = [...new Set(given.suns.map(sun => sun[0]))];
  const columns = [...new Set(given.suns.map(sun => sun[1]))].sort((a, b) => a - b);
  const chosen = {view: given.first[0], sun: given.first[1], scale: 0, level: -1, point: -1};
  const [LON, LAT, X, Y, LEVEL, NORTH] = [1, 2, 3, 4, 5, 6];

  // -- the claims of a point in a condition
  const flagsAt = (point, view, sun) => bytes[(point * views + view) * suns + sun];
  const claimAt = (point, scale, view, sun) =>
    count * views * suns + ((point * scales + scale) * views + view) * suns + sun;
  const codeOfLeast = Math.ceil(250 * (given.least - 0.002));
  const works = (point, scale, view, sun) => {
    const flags = flagsAt(point, view, sun);
    if (scale === 0) return (flags & USABLE) === USABLE;
    const code = bytes[claimAt(point, scale, view, sun)];
    return (flags & FREE) === FREE && code !== UNKNOWN && code >= codeOfLeast;
  };
  const claim = point => {
    const {scale, view, sun} = chosen, at = claimAt(point, scale, view, sun);
    const [detection, size, shape, angle] = [0, 1, 2, 3].map(k => bytes[at + k * plane]);
    const major = size === UNKNOWN ? NaN : given.sigma_m * given.sigma_ratio ** size;
    return {
      point, major, minor: major * shape / 254, angle, flags: flagsAt(point, view, sun),
      probability: detection === UNKNOWN ? NaN : detection / 250, works: works(point, scale, view, sun),
    };
  };
  const inLevel = point => chosen.level < 0 || given.points[point][LEVEL] === chosen.level;
  const cellOf = point => given.levels[given.points[point][LEVEL]];
  const shares = () => given.suns.map((_, sun) => {
    let seen = 0, good = 0;
    for (let point = 0; point < count; point++) {
      if (!inLevel(point) || !(flagsAt(point, chosen.view, sun) & EVALUATED)) continue;
      seen++;
      good += works(point, chosen.scale, chosen.view, sun);
    }
    return {seen, good};
  });

  // -- texts
  const shade = share => Math.min(COLOURS - 1, Math.floor(share * (COLOURS - 1) + 0.5));
  const short = metres => metres >= 100 ? metres.toFixed(0) : metres.toPrecision(2);
  const option = (value, text) => `<option value="${value}">${text}</option>`;
  const sunName = sun => {
    const [i, j] = given.suns[sun];
    return `azimuth ${given.azimuths[j]}°, elevation ${given.elevations[i]}°`;
  };
  const sigma = found => Number.isNaN(found.major) ? '–' : `${short(found.major)} × ${short(found.minor)}`;
  const reason = found => {
    if (!(found.flags & EVALUATED)) return 'this Sun never occurs there';
    if (found.works) return 'usable';
    const why = WHY.filter(([flag]) => !(found.flags & flag)).map(pair => pair[1]);
    return `not usable: ${why.length ? why.join(', ') : 'found too rarely at this image pixel'}`;
  };

  // -- map
  const canvas = element('dots'), [wide, high] = given.map_px;
  const draw = (found, holes) => {
    const box = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
    const scale = box.width / wide * ratio, style = getComputedStyle(document.documentElement);
    [canvas.width, canvas.height] = [wide * scale, high * scale];
    const ink = canvas.getContext('2d'), dot = Math.max(1, 0.7 * wide / box.width);
    const colours = [...Array(COLOURS).keys()].map(k => style.getPropertyValue(`--r${k}`).trim());
    ink.scale(scale, scale);
    ink.fillStyle = 'rgba(255,110,40,.28)';
    const side = Math.max(3 * dot, given.cells.side_px);
    for (const k of holes) ink.fillRect(given.cells.x[k] - side / 2, given.cells.y[k] - side / 2, side, side);
    const good = found.filter(one => one.works);
    const ellipse = (one, width, colour) => {
      const place = given.points[one.point], grow = given.px_per_m * given.enlarged;
      const turn = (one.angle + place[NORTH]) * Math.PI / 180;
      ink.beginPath();
      ink.ellipse(place[X], place[Y], one.minor * grow, one.major * grow, turn, 0, 2 * Math.PI);
      [ink.lineWidth, ink.strokeStyle] = [width, colour];
      ink.stroke();
    };
    if (good.length <= ELLIPSES) {
      for (const one of good) ellipse(one, 3.4, 'rgba(17,17,17,.6)');
      for (const one of good) ellipse(one, 1.6, '#fff');
    }
    const many = found.length > ELLIPSES;  // squares are drawn faster than circles
    for (let k = found.length - 1; k >= 0; k--) {
      const one = found[k], place = given.points[one.point], colour = colours[shade(one.probability)];
      if (ink.fillStyle !== colour) ink.fillStyle = colour;
      if (many) {
        const wide = (one.works ? 4 : 2) * dot;
        ink.fillRect(place[X] - wide / 2, place[Y] - wide / 2, wide, wide);
        continue;
      }
      ink.beginPath();
      ink.arc(place[X], place[Y], (one.works ? 4.2 : 3) * dot, 0, 2 * Math.PI);
      ink.fill();
      [ink.lineWidth, ink.strokeStyle] = [(one.works ? 1 : 0.6) * dot, '#fff'];
      ink.stroke();
    }
    if (chosen.point >= 0) {
      const place = given.points[chosen.point];
      for (const [width, colour] of [[4, '#111'], [2, '#ff5a4f']]) {
        ink.beginPath();
        ink.arc(place[X], place[Y], 10 * dot, 0, 2 * Math.PI);
        [ink.lineWidth, ink.strokeStyle] = [width * dot, colour];
        ink.stroke();
      }
    }
  };
  const nearestTo = (x, y, allowed = () => true) => {
    let best = -1, least = Infinity;
    for (let point = 0; point < count; point++) {
      const away = Math.hypot(given.points[point][X] - x, given.points[point][Y] - y);
      if (away < least && inLevel(point) && allowed(point)) [best, least] = [point, away];
    }
    return [best, least];
  };
  const under = event => {
    const box = canvas.getBoundingClientRect(), scale = wide / box.width;
    const [point, away] = nearestTo((event.clientX - box.left) * scale, (event.clientY - box.top) * scale);
    return away < REACH_PX * scale ? point : -1;
  };

  // -- charts
  const chart = found => {
    const [, column] = given.suns[chosen.sun], left = 60, top = 12, w = 366, h = 120;
    const bars = rows.map(row => given.suns.findIndex(sun => sun[0] === row && sun[1] === column));
    const most = Math.max(1, ...bars.map(sun => sun < 0 ? 0 : found[sun].good)), step = w / rows.length;
    const drawn = bars.map((sun, k) => {
      const good = sun < 0 ? 0 : found[sun].good, tall = h * good / most;
      const text = sun < 0 ? 'the Sun is never there' : `${sunName(sun)}: ${good} of ${found[sun].seen}`;
      return `<rect class="${sun === chosen.sun ? 'now' : 'bar'}" x="${left + (k + 0.15) * step}" y="${top + h - tall}" ` +
        `width="${0.7 * step}" height="${tall}"><title>${text}</title></rect>` +
        `<text class="middle" x="${left + (k + 0.5) * step}" y="${top + h + 16}">${given.elevations[rows[k]]}°</text>`;
    });
    element('by-elevation').innerHTML = `<path class="axis" d="M${left} ${top}v${h}h${w}"/>${drawn.join('')}` +
      `<text class="end" x="${left - 6}" y="${top + 9}">${most}</text><text class="end" x="${left - 6}" y="${top + h}">0</text>` +
      `<text class="name middle" x="${left + w / 2}" y="${top + h + 34}">Sun elevation</text>` +
      `<text class="name middle" transform="translate(12 ${top + h / 2}) rotate(-90)">usable points</text>`;
    element('elevation-words').textContent =
      `Usable points against the Sun’s elevation, at azimuth ${given.azimuths[column]}° in this view.`;
  };

  // -- one point
  const shadePatch = (picture, patch, cell) => {
    const side = patchSide, [row, column] = given.suns[chosen.sun], size = side * side;
    const z = new Float64Array(size), signed = new Int16Array(relief.buffer, patch * size * 2, size);
    for (let k = 0; k < size; k++) z[k] = signed[k] * given.patches.step_m;
    const elevation = given.elevations[row] * Math.PI / 180, azimuth = given.azimuths[column] * Math.PI / 180;
    const sun = [Math.cos(elevation) * Math.sin(azimuth), Math.cos(elevation) * Math.cos(azimuth), Math.sin(elevation)];
    const at = (i, j) => z[Math.min(side - 1, Math.max(0, i)) * side + Math.min(side - 1, Math.max(0, j))];
    const dark = (i, j) => {
      const steps = Math.hypot(sun[0], sun[1]) > 1e-9 ? 2 * side : 0, rise = sun[2] / Math.hypot(sun[0], sun[1]) * cell;
      for (let s = 1; s < steps; s++) {
        const along = s / 2, y = i - Math.cos(azimuth) * along, x = j + Math.sin(azimuth) * along;
        if (y < 0 || x < 0 || y > side - 1 || x > side - 1) return false;
        const [r, c] = [Math.floor(y), Math.floor(x)], [v, u] = [y - r, x - c];
        const ground = (1 - v) * ((1 - u) * at(r, c) + u * at(r, c + 1)) + v * ((1 - u) * at(r + 1, c) + u * at(r + 1, c + 1));
        if (ground > at(i, j) + rise * along + 1e-6) return true;
      }
      return false;
    };
    const light = new Float64Array(size);
    for (let i = 0; i < side; i++) {
      for (let j = 0; j < side; j++) {
        const across = i * side + j, spanX = Math.min(side - 1, j + 1) - Math.max(0, j - 1), spanY = Math.min(side - 1, i + 1) - Math.max(0, i - 1);
        const east = (at(i, j + 1) - at(i, j - 1)) / (spanX * cell), north = (at(i - 1, j) - at(i + 1, j)) / (spanY * cell);
        const long = Math.hypot(east, north, 1), incidence = (sun[2] - east * sun[0] - north * sun[1]) / long;
        light[across] = incidence <= 0 || dark(i, j) ? 0 : incidence / (incidence + 1 / long);
      }
    }
    const sorted = [...light].sort((a, b) => a - b);
    const [dim, bright] = [0.02, 0.98].map(share => sorted[Math.floor(share * (size - 1))]), span = bright - dim || 1;
    [picture.width, picture.height] = [side, side];
    const ink = picture.getContext('2d'), image = ink.createImageData(side, side);
    light.forEach((value, k) => image.data.set([0, 1, 2].map(() => 255 * Math.min(1, Math.max(0, (value - dim) / span))).concat(255), 4 * k));
    ink.putImageData(image, 0, 0);
  };
  const detail = () => {
    element('chosen-point').hidden = chosen.point < 0;
    if (chosen.point < 0) return;
    const [name, lon, lat] = given.points[chosen.point], found = claim(chosen.point), patch = patchOf.get(chosen.point);
    const cell = cellOf(chosen.point);
    const facts = [
      ['longitude', `${lon.toFixed(4)}° E`], ['latitude', `${lat.toFixed(4)}° N`],
      ['cell', `${short(cell)} m`], ['probability', Number.isNaN(found.probability) ? '–' : found.probability.toFixed(2)],
      ['1 sigma', `${sigma(found)} m`], ['under this Sun', reason(found)],
    ];
    element('point-name').textContent = `Point ${name}`;
    element('point-facts').innerHTML = facts.map(([term, text]) => `<dt>${term}</dt><dd>${text}</dd>`).join('');
    element('patch').hidden = patch === undefined;
    if (patch !== undefined) shadePatch(element('patch'), patch, cell);
    element('patch-words').textContent = patch === undefined
      ? 'The page does not hold this point’s heights.'
      : `The patch under this Sun (${sunName(chosen.sun)}), from straight above; shadows of terrain outside it are not drawn.`;
  };

  // -- everything
  const cells = () => {
    const away = [], place = chosen.view * suns + chosen.sun, row = Math.ceil(views * suns / 8);
    const known = given.cells.known[chosen.view][chosen.sun];
    for (let k = 0; known && k < given.cells.x.length; k++) {
      if (!(near[k * row + (place >> 3)] >> (7 - (place & 7)) & 1)) away.push(k);
    }
    const total = given.cells.x.length;
    const sample = given.cells.of > total ? ` (of an even sample of the ${given.cells.of})` : '';
    element('holes').textContent = known && total
      ? `${away.length} of ${total} spacing cells${sample} have no usable point within ${given.cells.spacing_km} km under this Sun.` : '';
    return form.holes.checked ? away : [];
  };
  let listed = [];
  const tableRow = found => {
    const [name, lon, lat] = given.points[found.point];
    return `<tr><td><button type="button" data-point="${found.point}">${name}</button></td><td>${lon.toFixed(4)}</td>` +
      `<td>${lat.toFixed(4)}</td><td>${short(cellOf(found.point))}</td><td>${found.probability.toFixed(2)}</td>` +
      `<td>${sigma(found)}</td><td>${found.angle}</td></tr>`;
  };
  let key = '', bySun = [];
  const update = () => {
    const now = [chosen.view, chosen.scale, chosen.level].join();
    if (now !== key) [key, bySun] = [now, shares()];
    const found = [];
    for (let point = 0; point < count; point++) {
      if (!inLevel(point) || !(flagsAt(point, chosen.view, chosen.sun) & EVALUATED)) continue;
      const one = claim(point);
      if (!Number.isNaN(one.probability)) found.push(one);
    }
    found.sort((a, b) => b.probability - a.probability || a.major - b.major);
    listed = found.filter(one => one.works);
    draw(found, cells());
    element('found').innerHTML = listed.slice(0, ROWS).map(tableRow).join('');
    const sigmas = listed.map(one => one.major).sort((a, b) => a - b);
    const middle = sigmas.length ? `, median sigma ${short(sigmas[Math.floor(sigmas.length / 2)])} m` : '';
    element('outcome').innerHTML = `<strong>${listed.length} of ${found.length}</strong> points are usable${middle}.`;
    element('more').textContent = listed.length > ROWS ? `The ${ROWS} most probable of ${listed.length} usable points.` : '';
    sky.forEach((cell, sun) => {
      const {seen, good} = bySun[sun], share = seen ? good / seen : 0;
      cell.setAttribute('class', `${seen ? `c${shade(share)}` : 'never'}${sun === chosen.sun ? ' chosen' : ''}`);
      cell.querySelector('title').textContent = seen ? `${sunName(sun)}: ${(100 * share).toFixed(0)} %` : `${sunName(sun)}: never there`;
    });
    chart(bySun);
    detail();
  };
  let waiting = false;
  const soon = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; update(); });
  };
  const choose = sun => {
    const [row, column] = given.suns[chosen.sun = sun];
    [form.elevation.value, form.azimuth.value] = [rows.indexOf(row), columns.indexOf(column)];
    element('elevation-is').textContent = `${given.elevations[row]}°`;
    element('azimuth-is').textContent = `${given.azimuths[column]}°`;
    soon();
  };
  const nearestSun = (row, column) => {
    const away = j => Math.abs((given.azimuths[j] - given.azimuths[column] + 540) % 360 - 180);
    const there = given.suns.map((sun, k) => [sun, k]).filter(pair => pair[0][0] === row);
    return there.reduce((best, pair) => away(pair[0][1]) < away(best[0][1]) ? pair : best)[1];
  };
  const sunAtAzimuth = (row, column) => {
    const there = given.suns.map((sun, k) => [sun, k]).filter(pair => pair[0][1] === column);
    return there.reduce((best, pair) => Math.abs(pair[0][0] - row) < Math.abs(best[0][0] - row) ? pair : best)[1];
  };
  const select = point => { chosen.point = point; soon(); };

  form.view.innerHTML = given.views.map((name, k) => option(k, name)).join('');
  form.scale.innerHTML = given.scales.map((s, k) => option(k, s === 1 ? 'the patch’s cell or finer' : `${s} cells`)).join('');
  form.level.innerHTML = option(-1, 'all') + given.levels.map((cell, k) => option(k, `cells of ${short(cell)} m`)).join('');
  element('level-choice').hidden = given.levels.length < 2;
  form.elevation.max = rows.length - 1;
  form.azimuth.max = columns.length - 1;
  for (const name of ['view', 'scale', 'level']) {
    form[name].addEventListener('change', () => { chosen[name] = +form[name].value; soon(); });
  }
  form.elevation.addEventListener('input', () => choose(nearestSun(rows[+form.elevation.value], given.suns[chosen.sun][1])));
  form.azimuth.addEventListener('input', () => choose(sunAtAzimuth(given.suns[chosen.sun][0], columns[+form.azimuth.value])));
  form.holes.addEventListener('change', soon);
  form.find.addEventListener('input', () => {
    const text = form.find.value.trim(), point = given.points.findIndex(one => one[0] === text);
    const like = point >= 0 || !text ? point : given.points.findIndex(one => one[0].startsWith(text));
    form.find.setCustomValidity(text && like < 0 ? 'no such point on this page' : '');
    form.find.reportValidity();
    select(like);
  });
  element('choices').addEventListener('submit', event => event.preventDefault());
  sky.forEach((cell, sun) => cell.addEventListener('click', () => choose(sun)));
  element('found').addEventListener('click', event => {
    if (event.target.dataset.point) select(+event.target.dataset.point);
  });
  canvas.addEventListener('click', event => select(under(event)));
  canvas.addEventListener('pointermove', event => {
    const point = under(event);
    canvas.title = point < 0 ? '' : `${given.points[point][0]}: ${reason(claim(point))}`;
  });
  canvas.addEventListener('keydown', event => {
    const way = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (event.key === 'Escape') select(-1);
    if (!way) return;
    event.preventDefault();
    const here = chosen.point < 0 ? [0, 0, 0, wide / 2, high / 2] : given.points[chosen.point];
    const ahead = point => {
      const [x, y] = [given.points[point][X] - here[X], given.points[point][Y] - here[Y]];
      const along = x * way[0] + y * way[1];
      return along > 0 && along >= Math.abs(x * way[1] + y * way[0]);
    };
    const [point] = nearestTo(here[X], here[Y], ahead);
    if (point >= 0) select(point);
  });
  element('copy').addEventListener('click', async () => {
    const head = 'point_id,longitude_deg,latitude_deg,gsd_m,detection_probability,sigma_major_m,sigma_minor_m,sigma_angle_deg';
    const lines = listed.map(one => {
      const [name, lon, lat] = given.points[one.point];
      return [name, lon, lat, cellOf(one.point), one.probability, one.major.toPrecision(4), one.minor.toPrecision(4), one.angle].join();
    });
    const text = [head, ...lines].join('\n') + '\n';
    try {
      await navigator.clipboard.writeText(text);
      element('copied').textContent = `${lines.length} points copied.`;
    } catch {
      const box = Object.assign(document.createElement('textarea'), {value: text});
      document.body.append(box);
      box.select();
      element('copied').textContent = document.execCommand('copy') ? `${lines.length} points copied.` : 'The browser does not allow to copy.';
      box.remove();
    }
  });
  window.addEventListener('resize', soon);
  matchMedia('(prefers-color-scheme:dark)').addEventListener('change', soon);
  element('chooser').hidden = false;
  choose(chosen.sun);
})();
