// Copyright 2026 The carracing_dqn authors
// SPDX-License-Identifier: Apache-2.0
// Shows what the stream says. Every text from outside goes in as text, never as markup.
'use strict';

const RETRY_MS = 3000;
const chosen = {car: null, plots: null};
let stream = null;
let shown = null;
let seeking = false;
let plotted = [];

const byId = (id) => document.getElementById(id);

function element(tag, text, name) {
  const made = document.createElement(tag);
  if (text !== undefined && text !== null) made.textContent = text;
  if (name) made.className = name;
  return made;
}

function number(value, digits = 2) {
  return value === null || value === undefined ? '-' : Number(value).toFixed(digits);
}

async function act(name, value = null) {
  const answer = await fetch('/act', {
    method: 'POST', headers: {'Content-Type': 'application/json'},
    body: JSON.stringify({name, value, namespace: shown && shown.namespace}),
  });
  if (!answer.ok) byId('notice').textContent = (await answer.text()) || `refused (${answer.status})`;
}

function connect() {
  if (stream) stream.close();
  const query = new URLSearchParams();
  if (chosen.car !== null) query.append('car', chosen.car);
  for (const name of chosen.plots || []) query.append('plot', name);
  stream = new EventSource(`/events?${query}`);
  stream.onmessage = (event) => show(JSON.parse(event.data));
  const own = stream;
  stream.onerror = () => {
    state('not connected', 'bad');
    // a browser that was refused does not try again by itself
    setTimeout(() => {
      if (own === stream && own.readyState === EventSource.CLOSED) connect();
    }, RETRY_MS);
  };
}

// fills a list anew only where it has changed: it may be open
function fill(list, names, shownAs = (name) => name) {
  if ([...list.options].map((option) => option.value).join('\n') === names.join('\n')) return;
  list.replaceChildren(...names.map((name) => {
    const option = element('option', shownAs(name));
    option.value = name;
    return option;
  }));
}

function state(text, name) {
  byId('link').textContent = text;
  byId('link').className = name;
}

function show(now) {
  shown = now;
  state('live', 'ok');
  byId('title').textContent = now.title;
  showCars(now);
  showCauses(now.causes, now.looking);
  showPicture(now);
  showControls(now);
  showDrive(now.drive);
  byId('nodes').replaceChildren(...now.nodes.map(nodeRow));
  byId('topics').replaceChildren(...now.topics.map(topicRow));
  if (now.plots) showPlots(now);
}

function showCars(now) {
  byId('car-label').hidden = now.cars.length < 2;
  const list = byId('car');
  fill(list, now.cars, (name) => name || '/');
  if (document.activeElement !== list) list.value = now.namespace;
}

function showCauses(causes, looking) {
  const items = causes.map((cause) => {
    const item = element('li', null, cause.kind === 'warning' ? 'warning' : '');
    item.append(element('b', cause.kind), element('span', `${cause.where}: ${cause.text}`));
    if (cause.mend) item.append(element('code', cause.mend));
    return item;
  });
  if (!items.length) {
    items.push(looking ? element('li', 'nothing so far, still looking')
      : element('li', 'nothing that can be seen from here', 'good'));
  }
  byId('causes').replaceChildren(...items);
}

function showPicture(now) {
  const picture = now.picture;
  byId('picture-text').textContent = picture
    ? `${picture.width}x${picture.height} ${picture.encoding}, stamp ${number(picture.stamp)} s`
    : 'no picture yet';
  if (picture && picture.data) {
    const image = byId('picture');
    image.width = picture.width;
    image.height = picture.height;
    image.src = picture.data;
  }
}

function showControls(now) {
  for (const part of document.querySelectorAll('[data-act]')) {
    part.hidden = !now.commands.includes(part.dataset.act);
  }
  byId('pause').textContent = now.switches.paused ? 'go on' : 'pause';
  byId('enable').textContent = now.switches.enabled === false ? 'enable' : 'disable';
  const epsilon = byId('epsilon');
  if (document.activeElement !== epsilon && now.switches.epsilon !== undefined) {
    epsilon.value = now.switches.epsilon;
  }
  if (now.playing.duration !== undefined) {
    const seek = byId('seek');
    seek.max = now.playing.duration;
    if (!seeking) seek.value = now.playing.position;
    byId('position').textContent =
      `${number(now.playing.position, 1)} of ${number(now.playing.duration, 1)} s`;
  }
  if (now.notice) byId('notice').textContent = now.notice;
}

function showDrive(drive) {
  const rows = [
    ['reward', number(drive.reward)], ['return', number(drive.episode_return, 1)],
    ['speed', number(drive.speed, 1)], ['episode', number(drive.episode, 0)],
    ['decision', number(drive.decision, 0)],
    ['linear', number(drive.linear)], ['angular', number(drive.angular)],
    ['weights', number(drive.version, 0)], ['validation', number(drive.validation, 1)],
  ];
  if (drive.tiles_total) {
    rows.push(['tiles', `${number(drive.tiles_visited, 0)} of ${number(drive.tiles_total, 0)}`]);
  }
  byId('numbers').replaceChildren(
    ...rows.flatMap(([name, value]) => [element('dt', name), element('dd', value)]));
  const actions = drive.actions || [];
  const values = actions.map((one) => one[1]).filter((one) => one !== null);
  const low = Math.min(...values);
  const spread = Math.max(...values) - low || 1;
  byId('actions').replaceChildren(...actions.map(([name, value], index) => {
    const taken = drive.chosen.includes(index);
    const row = element('div', null, taken ? 'action chosen' : 'action');
    const bar = element('meter');
    // the bars show the differences, which are small beside the values
    bar.value = value === null ? 0 : 0.03 + 0.97 * (value - low) / spread;
    row.append(element('span', taken && drive.explored ? `${name} (random)` : name),
               element('span', number(value)), bar);
    return row;
  }));
}

function nodeRow(node) {
  const bad = node.state === 'gone' || node.state === 'silent' || node.level === 'error';
  const name = bad ? 'bad' : node.level === 'warn' ? 'warn' : node.level === 'ok' ? 'ok' : 'dim';
  const row = element('tr');
  row.append(element('td', node.name),
             element('td', node.state === 'running' ? node.level : node.state, name),
             element('td', node.summary, 'wide'), element('td', number(node.age, 1), 'number'));
  row.title = Object.entries(node.values).map((pair) => pair.join(': ')).join('\n');
  return row;
}

// nodes of one QoS together
function ends(list) {
  const groups = new Map();
  for (const end of list) groups.set(end.qos, [...(groups.get(end.qos) || []), end.node]);
  return [...groups].map(([qos, nodes]) => `${nodes.join(', ')} (${qos})`).join('; ') || '-';
}

function topicRow(topic) {
  const row = element('tr');
  row.title = topic.type;
  const to = element('td', ends(topic.subscriptions), 'wide');
  for (const misfit of topic.misfits) {
    to.append(element('div', `${misfit.publisher} -> ${misfit.subscription}: ${misfit.reason}`,
                      'bad'));
  }
  row.append(element('td', topic.name), element('td', number(topic.rate, 1), 'number'),
             element('td', number(topic.age, 1), 'number'),
             element('td', ends(topic.publishers), 'wide'), to);
  return row;
}

function showPlots(now) {
  plotted = Object.keys(now.plots);
  fill(byId('more'), ['', ...now.series]);
  byId('plots').replaceChildren(...Object.entries(now.plots).map(([name, points]) => {
    const plot = element('div', null, 'plot');
    const head = element('div');
    const values = points.map((one) => one[1]);
    const low = Math.min(...values);
    const high = Math.max(...values);
    const remove = element('button', '×');
    remove.setAttribute('aria-label', `remove ${name}`);
    remove.onclick = () => choose(plotted.filter((one) => one !== name));
    head.append(element('span', `${name}: ${number(values[values.length - 1])}`),
                element('span', `${number(low)} to ${number(high)}`, 'dim'), remove);
    const canvas = element('canvas');
    plot.append(head, canvas);
    requestAnimationFrame(() => draw(canvas, points, low, high));
    return plot;
  }));
}

function choose(names) {
  chosen.plots = names;
  connect();
}

function draw(canvas, points, low, high) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.width = canvas.clientWidth * scale;
  const height = canvas.height = canvas.clientHeight * scale;
  const context = canvas.getContext('2d');
  const style = getComputedStyle(document.documentElement);
  context.strokeStyle = style.getPropertyValue('--line');
  context.strokeRect(0, 0, width, height);
  context.strokeStyle = context.fillStyle = style.getPropertyValue('--blue');
  context.lineWidth = 1.5 * scale;
  context.beginPath();
  const oldest = Math.max(points[0][0], 1);
  for (const [ago, value] of points) {
    const x = width * (1 - ago / oldest);
    const y = height - 3 * scale - (height - 6 * scale) * (value - low) / (high - low || 1);
    if (points.length < 3) context.fillRect(x - 2 * scale, y - 2 * scale, 4 * scale, 4 * scale);
    context.lineTo(x, y);
  }
  context.stroke();
}

byId('car').onchange = (event) => { chosen.car = event.target.value; connect(); };
byId('more').onchange = (event) => {
  if (event.target.value) choose([...plotted, event.target.value]);
  event.target.value = '';
};
byId('pause').onclick = () => act('pause', !shown.switches.paused);
byId('enable').onclick = () => act('enable', shown.switches.enabled === false);
for (const button of document.querySelectorAll('button[data-act=step], button[data-act=reset]')) {
  button.onclick = () => act(button.dataset.act);
}
byId('epsilon').onchange = (event) => {
  if (event.target.value !== '') act('epsilon', Number(event.target.value));
};
byId('rate').onchange = (event) => act('rate', Number(event.target.value));
byId('seek').oninput = () => { seeking = true; };
byId('seek').onchange = (event) => { seeking = false; act('seek', Number(event.target.value)); };
document.addEventListener('keydown', (event) => {
  if (!shown || /INPUT|SELECT|BUTTON/.test(event.target.tagName)) return;
  if (event.key === ' ') { act('pause', !shown.switches.paused); event.preventDefault(); }
  if (event.key === 's') act('step');
});
connect();
