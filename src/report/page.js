// What moves on a page. Without it everything is there to be read: it takes its numbers from what is
// drawn, and asks nothing of anyone.
(() => {
  'use strict';
  // Size of a drawing in its own units, as the frame is written.
  const W = 20000, H = 5000;
  const all = (what, within = document) => [...within.querySelectorAll(what)];
  const numbers = text => text.split(' ').map(Number);
  document.body.classList.add('moves');

  // Round numbers about so many on an axis, as the page has them at first.
  const ticks = (low, high, count) => {
    const rough = (high - low) / Math.max(count, 2), power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map(f => f * power).find(s => s >= 0.7 * rough);
    if (!(step > 0)) return [];
    const decimals = Math.min(9, Math.max(0, -Math.floor(Math.log10(step * 1.000001))));
    const out = [];
    for (let n = Math.ceil(low / step); n * step <= high && out.length < 100; n++) {
      out.push([n * step, (n * step).toFixed(decimals)]);
    }
    return out;
  };
  const short = v => {
    if (v === 0) return '0';
    return v.toFixed(Math.min(6, Math.max(0, 3 - Math.floor(Math.log10(Math.abs(v))))));
  };

  // A curve's points, read back from its path: M is absolute, what follows l are steps.
  const points = path => {
    const xs = [], ys = [];
    let x = 0, y = 0, absolute = true;
    const tokens = path.getAttribute('d').match(/[Ml]|-?\d+/g) || [];
    for (let i = 0; i < tokens.length;) {
      if (tokens[i] === 'M') { absolute = true; i++; continue; }
      if (tokens[i] === 'l') { absolute = false; i++; continue; }
      const a = Number(tokens[i]), b = Number(tokens[i + 1]);
      i += 2;
      if (absolute) {
        if (xs.length) { xs.push(a); ys.push(NaN); }
        x = a; y = b;
      } else if (a === 0 && b === 0) {
        continue;
      } else { x += a; y += b; }
      xs.push(x); ys.push(y);
    }
    return { xs, ys };
  };
  // Index of the first place at or after `x`.
  const after = (xs, x) => {
    let low = 0, high = xs.length;
    while (low < high) { const mid = (low + high) >> 1; if (xs[mid] < x) low = mid + 1; else high = mid; }
    return low;
  };

  class Plot {
    constructor(el) {
      this.el = el;
      this.svg = el.querySelector('svg');
      this.frame = el.querySelector('.frame');
      this.grid = el.querySelector('.grid');
      this.tickBox = el.querySelector('.ticks');
      this.read = el.querySelector('.read');
      this.x = numbers(el.dataset.x);
      this.y = numbers(el.dataset.y);
      this.view = this.x;
      this.group = el.dataset.group || el;
      this.cross = this.frame.appendChild(document.createElement('div'));
      this.cross.className = 'cross';
      this.chosen = this.frame.appendChild(document.createElement('div'));
      this.chosen.className = 'chosen';
      this.frame.tabIndex = 0;
    }
    get curves() {
      this.kept ??= all('path.curve', this.svg).map(path => ({ path, name: path.dataset.name, ...points(path) }));
      return this.kept;
    }
    shown() { return this.curves.filter(c => !c.path.classList.contains('off')); }
    across(value) { return W * (value - this.x[0]) / (this.x[1] - this.x[0]); }
    value(down) { return this.y[0] + (1 - down / H) * (this.y[1] - this.y[0]); }
    isWhole() { return this.view[0] <= this.x[0] && this.view[1] >= this.x[1]; }
    show(low, high) {
      this.view = [low, high];
      const from = this.across(low), to = this.across(high);
      let top = 0, bottom = H;
      const whole = this.isWhole();
      const curves = this.shown();
      if (curves.length && !(whole && curves.length === this.curves.length)) {
        let least = Infinity, most = -Infinity;
        for (const { xs, ys } of curves) {
          // With a point on either side, which lines to it may cross the frame.
          for (let i = Math.max(0, after(xs, from) - 1); i < xs.length; i++) {
            if (ys[i] < least) least = ys[i];
            if (ys[i] > most) most = ys[i];
            if (xs[i] > to) break;
          }
        }
        if (most >= least) {
          const air = Math.max(0.06 * (most - least), 20);
          top = least - air; bottom = most + air;
        }
      }
      this.svg.setAttribute('viewBox', `${from} ${top} ${to - from} ${bottom - top}`);
      const yLow = this.value(bottom), yHigh = this.value(top);
      let lines = '', texts = '';
      for (const [v, text] of ticks(yLow, yHigh, this.frame.clientHeight / 26)) {
        const share = (yHigh - v) / (yHigh - yLow);
        lines += `M${from} ${top + share * (bottom - top)}h${to - from}`;
        texts += `<span class="y" style="top:${100 * share}%">${text}</span>`;
      }
      ticks(low, high, 9).forEach(([v, text], i) => {
        const share = (v - low) / (high - low);
        lines += `M${from + share * (to - from)} ${top}v${bottom - top}`;
        texts += `<span class="x${i % 2 ? ' more' : ''}" style="left:${100 * share}%">${text}</span>`;
      });
      this.grid.setAttribute('d', lines);
      this.tickBox.innerHTML = texts;
      for (const span of all('.phase', this.frame)) {
        const [a, b] = numbers(span.dataset.x).map(v => Math.min(1, Math.max(0, (v - low) / (high - low))));
        span.style.cssText = `left:${100 * a}%;width:${100 * (b - a)}%`;
        span.classList.remove('more');
        span.classList.toggle('off', (b - a) * this.frame.clientWidth < 6.5 * span.textContent.length);
      }
    }
    point(value) {
      const [low, high] = this.view;
      const inside = value !== null && value >= low && value <= high;
      this.cross.style.display = inside ? 'block' : 'none';
      if (!inside) { this.read.textContent = ''; return; }
      this.cross.style.left = `${100 * (value - low) / (high - low)}%`;
      const at = this.across(value), reach = W * (high - low) / (this.x[1] - this.x[0]) / 40;
      this.read.textContent = '';
      const say = (text, kind) => {
        const part = this.read.appendChild(document.createElement(kind));
        part.textContent = text;
        return part;
      };
      say(`${short(value)}  `, 'b');
      for (const { path, name, xs, ys } of this.shown().slice(0, 8)) {
        let i = after(xs, at);
        if (i > 0 && (i === xs.length || at - xs[i - 1] < xs[i] - at || !(ys[i] === ys[i]))) i--;
        if (i < xs.length && ys[i] === ys[i] && Math.abs(xs[i] - at) <= reach) {
          const part = say(`${name} `, 'i');
          part.style.color = getComputedStyle(path).stroke;
          const number = part.appendChild(document.createElement('b'));
          number.textContent = short(this.value(ys[i]));
        }
      }
    }
  }

  const plots = all('.plot[data-x]').map(el => new Plot(el));
  const groups = new Map();
  for (const plot of plots) groups.set(plot.group, [...(groups.get(plot.group) || []), plot]);
  const whole = group => [
    Math.min(...groups.get(group).map(p => p.x[0])), Math.max(...groups.get(group).map(p => p.x[1])),
  ];
  const zoom = (group, low, high) => {
    const [least, most] = whole(group);
    const width = Math.min(most - least, Math.max(high - low, (most - least) * 1e-4));
    low = Math.min(Math.max(low, least), most - width);
    for (const plot of groups.get(group)) {
      if (width >= most - least) plot.show(...plot.x); else plot.show(low, low + width);
    }
  };
  let due = 0;
  const point = (group, value) => {
    cancelAnimationFrame(due);
    due = requestAnimationFrame(() => groups.get(group).forEach(plot => plot.point(value)));
  };

  for (const plot of plots) {
    const { frame, group } = plot;
    const value = event => {
      const box = frame.getBoundingClientRect();
      const share = Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
      return plot.view[0] + share * (plot.view[1] - plot.view[0]);
    };
    const about = (middle, factor) => {
      const [low, high] = plot.view;
      zoom(group, middle - (middle - low) * factor, middle + (high - middle) * factor);
    };
    const down = new Map();
    let drag = null, pinch = null;
    frame.addEventListener('pointerdown', event => {
      if (event.button) return;
      down.set(event.pointerId, event.clientX);
      frame.setPointerCapture(event.pointerId);
      if (down.size === 2) {
        const [a, b] = down.values();
        pinch = { apart: Math.max(10, Math.abs(a - b)), view: plot.view, middle: value({ clientX: (a + b) / 2 }) };
        drag = null;
      } else if (event.pointerType === 'mouse') {
        drag = { from: event.clientX, at: value(event), view: plot.view, pans: event.shiftKey };
      } else point(group, value(event));
    });
    frame.addEventListener('pointermove', event => {
      if (down.has(event.pointerId)) down.set(event.pointerId, event.clientX);
      if (pinch && down.size === 2) {
        const [a, b] = down.values(), factor = pinch.apart / Math.max(10, Math.abs(a - b));
        const [low, high] = pinch.view;
        zoom(group, pinch.middle - (pinch.middle - low) * factor, pinch.middle + (high - pinch.middle) * factor);
      } else if (drag && drag.pans) {
        const width = drag.view[1] - drag.view[0];
        const moved = (event.clientX - drag.from) / frame.clientWidth * width;
        zoom(group, drag.view[0] - moved, drag.view[1] - moved);
      } else {
        point(group, value(event));
        if (drag) {
          const box = frame.getBoundingClientRect();
          const [a, b] = [drag.from, event.clientX].map(x => Math.min(box.width, Math.max(0, x - box.left)));
          plot.chosen.style.cssText = `display:block;left:${Math.min(a, b)}px;width:${Math.abs(b - a)}px`;
        }
      }
    });
    const up = event => {
      if (drag && !drag.pans && event.type === 'pointerup' && Math.abs(event.clientX - drag.from) > 5) {
        const at = value(event);
        zoom(group, Math.min(drag.at, at), Math.max(drag.at, at));
      }
      plot.chosen.style.display = 'none';
      down.delete(event.pointerId);
      drag = pinch = null;
    };
    frame.addEventListener('pointerup', up);
    frame.addEventListener('pointercancel', up);
    frame.addEventListener('pointerleave', () => { if (!drag) point(group, null); });
    frame.addEventListener('dblclick', () => zoom(group, ...whole(group)));
    frame.addEventListener('wheel', event => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      about(value(event), Math.exp(0.002 * Math.max(-300, Math.min(300, event.deltaY))));
    }, { passive: false });
    let at = null;
    frame.addEventListener('blur', () => point(group, at = null));
    frame.addEventListener('keydown', event => {
      const [low, high] = plot.view, width = high - low;
      const middle = at !== null && at >= low && at <= high ? at : (low + high) / 2;
      const side = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (side && event.shiftKey) zoom(group, low + side * width / 8, high + side * width / 8);
      else if (side) point(group, at = Math.min(high, Math.max(low, middle + side * width / 100)));
      else if (event.key === '+' || event.key === '=') about(middle, 0.7);
      else if (event.key === '-') about(middle, 1 / 0.7);
      else if (event.key === '0' || event.key === 'Escape') zoom(group, ...whole(group));
      else return;
      event.preventDefault();
    });
  }

  // A name in a legend switches its curve.
  for (const item of all('.legend [data-name]')) {
    const chart = item.closest('.chart');
    const name = item.dataset.name;
    const curves = chart ? all('path', chart).filter(p => !p.closest('.legend') && (p.dataset.name === name || p.dataset.of === name)) : [];
    if (!curves.length) continue;
    item.setAttribute('role', 'button');
    item.setAttribute('aria-pressed', 'true');
    item.tabIndex = 0;
    const toggle = () => {
      const on = item.getAttribute('aria-pressed') !== 'true';
      item.setAttribute('aria-pressed', on);
      curves.forEach(curve => curve.classList.toggle('off', !on));
      for (const plot of plots) if (chart.contains(plot.el)) plot.show(...plot.view);
    };
    item.addEventListener('click', toggle);
    item.addEventListener('keydown', event => {
      if (event.key === 'Enter' || event.key === ' ') { event.preventDefault(); toggle(); }
    });
  }

  // An event leads to its instant.
  for (const link of all('a[data-at]')) {
    link.addEventListener('click', () => {
      const at = Number(link.dataset.at);
      for (const group of groups.keys()) {
        if (typeof group !== 'string' || !group.startsWith('time')) continue;
        const [low, high] = whole(group), side = Math.min((high - low) / 2, Math.max(2, (high - low) / 100));
        zoom(group, at - side, at + side);
        requestAnimationFrame(() => groups.get(group).forEach(plot => plot.point(at)));
      }
    });
  }

  // The path in space turns.
  for (const scene of all('.scene')) {
    const svg = scene.querySelector('svg');
    const [width, height] = numbers(svg.getAttribute('viewBox')).slice(2), margin = 44;
    const parts = all('[data-p]', scene).map(el => ({
      el, runs: el.dataset.p.split(',').map(run => numbers(run)),
    })).filter(part => part.runs[0].length >= 3);
    let [azimuth, elevation] = numbers(scene.dataset.view), size = 1, due = 0;
    const first = [azimuth, elevation];
    const draw = () => {
      const [sa, ca, se, ce] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(elevation), Math.cos(elevation)];
      const at = (n, e, d) => [e * ca - n * sa, -((e * sa + n * ca) * se - d * ce)];
      let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
      const seen = parts.map(({ el, runs }) => ({ el, runs: runs.map(run => {
        const out = [];
        for (let i = 0; i + 2 < run.length; i += 3) {
          const [x, y] = at(run[i], run[i + 1], run[i + 2]);
          left = Math.min(left, x); right = Math.max(right, x);
          top = Math.min(top, y); bottom = Math.max(bottom, y);
          out.push([x, y]);
        }
        return out;
      }) }));
      const scale = size * Math.min((width - 2 * margin) / Math.max(right - left, 1), (height - 2 * margin) / Math.max(bottom - top, 1));
      const place = ([x, y]) => [width / 2 + (x - (left + right) / 2) * scale, height / 2 + (y - (top + bottom) / 2) * scale];
      for (const { el, runs } of seen) {
        if (el.tagName === 'path') {
          el.setAttribute('d', runs.map(run => 'M' + run.map(p => place(p).map(v => v.toFixed(1)).join(' ')).join('L')).join(''));
        } else {
          const [x, y] = place(runs[0][0]);
          el.style.left = `${100 * x / width}%`;
          el.style.top = `${100 * y / height}%`;
        }
      }
    };
    const turn = (a, e) => {
      azimuth += a;
      elevation = Math.min(Math.PI / 2, Math.max(0, elevation + e));
      cancelAnimationFrame(due);
      due = requestAnimationFrame(draw);
    };
    let last = null;
    scene.tabIndex = 0;
    scene.style.overflow = 'hidden';
    scene.addEventListener('pointerdown', event => { last = event; scene.setPointerCapture(event.pointerId); });
    scene.addEventListener('pointermove', event => {
      if (!last) return;
      turn((event.clientX - last.clientX) * 0.008, (event.clientY - last.clientY) * 0.008);
      last = event;
    });
    for (const end of ['pointerup', 'pointercancel']) scene.addEventListener(end, () => { last = null; });
    const reset = () => { [azimuth, elevation] = first; size = 1; turn(0, 0); };
    scene.addEventListener('dblclick', reset);
    scene.addEventListener('wheel', event => {
      if (!event.ctrlKey && !event.metaKey) return;
      event.preventDefault();
      size = Math.min(20, Math.max(0.3, size * Math.exp(-0.002 * event.deltaY)));
      turn(0, 0);
    }, { passive: false });
    scene.addEventListener('keydown', event => {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (step) turn(...step);
      else if (event.key === '+' || event.key === '=') { size *= 1.25; turn(0, 0); }
      else if (event.key === '-') { size /= 1.25; turn(0, 0); }
      else if (event.key === '0') reset();
      else return;
      event.preventDefault();
    });
  }
})();
