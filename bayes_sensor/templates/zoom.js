"use strict";
// Zoom of the overlays: every sample, drawn as least and greatest where a pixel holds many.
// Samples are steps in Rice's code (see samples.py); nothing is fetched from anywhere.
(function () {
  var LONGEST_RUN = 24, BLOCK = 8, LEFT = 62, RIGHT = 12, TOP = 12, BOTTOM = 38, GAP = 26;

  // ---------------------------------------------------------------- decoding
  function bytes(text) {
    var raw = atob(text), out = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i += 1) { out[i] = raw.charCodeAt(i); }
    return out;
  }
  function floats(text) {
    var view = new DataView(bytes(text).buffer), out = new Float64Array(view.byteLength / 4);
    for (var i = 0; i < out.length; i += 1) { out[i] = view.getFloat32(4 * i, true); }
    return out;
  }
  function integers(text) {
    var view = new DataView(bytes(text).buffer), out = new Float64Array(view.byteLength / 4);
    for (var i = 0; i < out.length; i += 1) { out[i] = view.getUint32(4 * i, true); }
    return out;
  }
  function unrice(code, k, n, offset, step) {
    var out = new Float64Array(n), place = 0, value = 0;
    function bit() {
      var b = (code[place >> 3] >> (7 - (place & 7))) & 1;
      place += 1;
      return b;
    }
    function word(count) {
      var w = 0;
      for (var j = 0; j < count; j += 1) { w = 2 * w + bit(); }
      return w;
    }
    for (var i = 0; i < n; i += 1) {
      var ones = 0;
      while (ones < LONGEST_RUN && bit()) { ones += 1; }
      var u = ones === LONGEST_RUN ? word(32) : ones * Math.pow(2, k) + word(k);
      value += u % 2 ? -(u + 1) / 2 : u / 2;
      out[i] = offset + step * value;
    }
    return out;
  }
  function decode(data) {
    var n = data.n, t = new Float64Array(n), lone = new Float64Array(n), place = 0;
    data.runs.forEach(function (run) {
      for (var j = 0; j < run[1]; j += 1) {
        t[place] = data.start + data.interval * (run[0] + run[2] * j);
        lone[place] = data.interval * run[2];
        place += 1;
      }
    });
    var trace = {
      t: t, spacing: lone, y: unrice(bytes(data.bits), data.k, n, data.offset, data.step),
      mt: integers(data.model_t).map(function (i) { return data.start + data.interval * i; }),
      model: floats(data.model), sd: floats(data.sd)
    };
    var r = new Float64Array(n), node = 0;
    for (var i = 0; i < n; i += 1) {
      while (node < trace.mt.length - 2 && trace.mt[node + 1] < t[i]) { node += 1; }
      r[i] = trace.y[i] - along(trace, trace.model, node, t[i]);
    }
    trace.r = r;
    trace.ranges = { y: levels(trace.y), r: levels(r) };
    return trace;
  }
  function along(trace, values, node, at) {
    var a = trace.mt[node], b = trace.mt[node + 1];
    return b === undefined ? values[node]
      : values[node] + (values[node + 1] - values[node]) * (at - a) / (b - a);
  }
  function levels(values) {
    // least and greatest of 8, 64, 512, .. samples
    var found = [], low = values, high = values;
    while (low.length > 4 * BLOCK) {
      var n = Math.ceil(low.length / BLOCK), nextLow = new Float64Array(n), nextHigh = new Float64Array(n);
      for (var i = 0; i < n; i += 1) {
        var a = Infinity, b = -Infinity, end = Math.min((i + 1) * BLOCK, low.length);
        for (var j = i * BLOCK; j < end; j += 1) {
          if (low[j] < a) { a = low[j]; }
          if (high[j] > b) { b = high[j]; }
        }
        nextLow[i] = a; nextHigh[i] = b;
      }
      found.push([nextLow, nextHigh]);
      low = nextLow; high = nextHigh;
    }
    return found;
  }
  function range(values, ranges, a, b) {
    // least and greatest of values[a..b), blocks where whole ones lie inside
    var low = Infinity, high = -Infinity, level = -1, size = 1;
    function take(x, y) { if (x < low) { low = x; } if (y > high) { high = y; } }
    while (a < b) {
      while (level + 1 < ranges.length && a % (size * BLOCK) === 0 && a + size * BLOCK <= b) {
        level += 1; size *= BLOCK;
      }
      while (level >= 0 && (a % size !== 0 || a + size > b)) { level -= 1; size /= BLOCK; }
      if (level < 0) { take(values[a], values[a]); } else {
        take(ranges[level][0][a / size], ranges[level][1][a / size]);
      }
      a += size;
    }
    return [low, high];
  }
  function first(values, at) {
    // index of the first value at or above
    var a = 0, b = values.length;
    while (a < b) { var m = (a + b) >> 1; if (values[m] < at) { a = m + 1; } else { b = m; } }
    return a;
  }

  // ---------------------------------------------------------------- axes
  function ticks(low, high, count) {
    var rough = (high - low) / count, size = Math.pow(10, Math.floor(Math.log10(rough)));
    var step = [1, 2, 5, 10].map(function (m) { return m * size; })
      .filter(function (s) { return s >= rough * 0.999; })[0];
    var digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), found = [];
    for (var i = Math.ceil(low / step - 1e-9); i * step <= high + 1e-9 * step; i += 1) {
      found.push([i * step, (i * step).toFixed(digits)]);
    }
    return found;
  }

  // ---------------------------------------------------------------- the viewer
  function Viewer(figure, data, done, quiet) {
    var trace = decode(data), small = data.unit === "V" ? ["mV", 1e3] : [data.unit, 1];
    var whole = [trace.t[0], trace.t[trace.t.length - 1]], view = whole.slice(), pointer = null;
    var box = document.createElement("div"), bar = document.createElement("div");
    var canvas = document.createElement("canvas"), words = document.createElement("p");
    var paint = canvas.getContext("2d"), held = {}, reach = null, pending = false;
    box.className = "zoom"; bar.className = "bar"; words.className = "readout";
    words.setAttribute("aria-live", "polite");
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-label", "Measurement, model and residual. Arrow keys move, plus and "
      + "minus zoom, Home shows the whole record, Escape closes.");
    var least = Math.min(whole[1] - whole[0], 8 * data.interval);

    function set(a, b) {
      var span = Math.min(Math.max(b - a, least), whole[1] - whole[0]), middle = (a + b) / 2;
      a = Math.min(Math.max(middle - span / 2, whole[0]), whole[1] - span);
      view = [a, a + span];
      if (!pending) {
        pending = true;
        requestAnimationFrame(redraw);
        setTimeout(redraw, 100); // where nothing is shown, frames never come
      }
    }
    function redraw() { if (pending) { pending = false; draw(); } }
    function zoom(factor, at) {
      at = at === undefined ? (view[0] + view[1]) / 2 : at;
      set(at - (at - view[0]) * factor, at + (view[1] - at) * factor);
    }
    function move(part) {
      var by = part * (view[1] - view[0]);
      by = Math.max(whole[0] - view[0], Math.min(by, whole[1] - view[1]));
      set(view[0] + by, view[1] + by);
    }
    function button(text, title, act) {
      var b = document.createElement("button");
      b.type = "button"; b.textContent = text; b.title = title;
      b.setAttribute("aria-label", title);
      b.addEventListener("click", act);
      bar.appendChild(b);
    }
    button("whole", "whole record", function () { set(whole[0], whole[1]); });
    Object.keys(data.views).forEach(function (name) {
      button(name, name + " of the step", function () { set(data.views[name][0], data.views[name][1]); });
    });
    button("−", "zoom out", function () { zoom(2); });
    button("+", "zoom in", function () { zoom(0.5); });
    button("‹", "earlier", function () { move(-0.4); });
    button("›", "later", function () { move(0.4); });
    button("close", "back to the drawing", function () { done(); });

    function colour(name) { return getComputedStyle(box).getPropertyValue("--" + name).trim(); }
    function place(at, width) {
      return LEFT + (at - view[0]) / (view[1] - view[0]) * (width - LEFT - RIGHT);
    }
    function time(x) {
      var width = canvas.clientWidth - LEFT - RIGHT;
      return view[0] + (x - LEFT) / width * (view[1] - view[0]);
    }

    function panel(values, ranges, top, height, width, label, unit, extra) {
      var a = first(trace.t, view[0]), b = first(trace.t, view[1] + 1e-12), n = values.length;
      var seen = range(values, ranges, a, Math.max(b, Math.min(a + 1, n)));
      extra.limits.forEach(function (v) { seen = [Math.min(seen[0], v), Math.max(seen[1], v)]; });
      var pad = 0.06 * (seen[1] - seen[0]) || 1;
      var low = seen[0] - pad, high = seen[1] + pad;
      function up(v) { return top + height - (v - low) / (high - low) * height; }
      paint.fillStyle = paint.strokeStyle = colour("f-1b1b1b");
      paint.textAlign = "right"; paint.textBaseline = "middle";
      ticks(low * unit, high * unit, Math.max(height / 36, 3)).forEach(function (tick) {
        var y = up(tick[0] / unit);
        paint.fillText(tick[1], LEFT - 6, y);
        paint.strokeStyle = colour("f-d4d4d4"); paint.lineWidth = 0.6;
        paint.beginPath(); paint.moveTo(LEFT, y); paint.lineTo(width - RIGHT, y); paint.stroke();
      });
      paint.save();
      paint.translate(13, top + height / 2); paint.rotate(-Math.PI / 2);
      paint.textAlign = "center"; paint.fillText(label, 0, 0);
      paint.restore();
      paint.save();
      paint.beginPath(); paint.rect(LEFT, top, width - LEFT - RIGHT, height); paint.clip();
      var columns = Math.max(1, Math.round(width - LEFT - RIGHT));
      paint.strokeStyle = paint.fillStyle = colour("f-8fb4d3");
      if (b - a > 1.5 * columns) {
        var from = a, join = null;
        for (var c = 0; c < columns; c += 1) {
          var to = first(trace.t, view[0] + (c + 1) / columns * (view[1] - view[0]));
          if (to > from) {
            var lh = range(values, ranges, from, to), y0 = up(lh[1]), y1 = up(lh[0]);
            if (join) { y0 = Math.min(y0, join[1]); y1 = Math.max(y1, join[0]); }
            paint.fillRect(LEFT + c, y0, 1, Math.max(1, y1 - y0));
            join = [up(lh[1]), up(lh[0])];
          } else { join = null; }
          from = to;
        }
      } else {
        paint.lineWidth = 1.2; paint.strokeStyle = paint.fillStyle = colour("f-0072b2");
        paint.beginPath();
        a = Math.max(0, a - 1); b = Math.min(n, b + 1);
        for (var i = a; i < b; i += 1) {
          var apart = i > a && trace.t[i] - trace.t[i - 1] > 1.5 * Math.max(trace.spacing[i], trace.spacing[i - 1]);
          paint[i === a || apart ? "moveTo" : "lineTo"](place(trace.t[i], width), up(values[i]));
        }
        paint.stroke();
        if (b - a < columns / 4) {
          for (i = a; i < b; i += 1) {
            paint.beginPath(); paint.arc(place(trace.t[i], width), up(values[i]), 2, 0, 7); paint.fill();
          }
        }
      }
      extra.draw(up, columns);
      paint.restore();
    }
    function curve(values, factor, up, columns) {
      var node = Math.max(0, first(trace.mt, view[0]) - 1);
      paint.beginPath();
      for (var c = 0; c <= columns; c += 1) {
        var at = view[0] + c / columns * (view[1] - view[0]);
        while (node < trace.mt.length - 2 && trace.mt[node + 1] < at) { node += 1; }
        paint[c ? "lineTo" : "moveTo"](LEFT + c, up(factor * along(trace, values, node, at)));
      }
      paint.stroke();
    }
    function draw() {
      var scale = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
      if (!width) { return; }
      canvas.width = Math.round(width * scale); canvas.height = Math.round(height * scale);
      paint.setTransform(scale, 0, 0, scale, 0, 0);
      paint.clearRect(0, 0, width, height);
      paint.font = "12px system-ui, sans-serif";
      var inner = height - TOP - BOTTOM - GAP, upper = Math.round(0.6 * inner), lower = inner - upper;
      paint.textAlign = "center"; paint.textBaseline = "top";
      ticks(view[0], view[1], (width - LEFT - RIGHT) / 90).forEach(function (tick) {
        var x = place(tick[0], width);
        paint.strokeStyle = colour("f-d4d4d4"); paint.lineWidth = 0.6;
        paint.beginPath();
        paint.moveTo(x, TOP); paint.lineTo(x, TOP + upper);
        paint.moveTo(x, TOP + upper + GAP); paint.lineTo(x, height - BOTTOM);
        paint.stroke();
        paint.fillStyle = colour("f-1b1b1b");
        paint.fillText(tick[1], x, height - BOTTOM + 5);
      });
      paint.fillText("time (s)", LEFT + (width - LEFT - RIGHT) / 2, height - 15);
      panel(trace.y, trace.ranges.y, TOP, upper, width, "signal (" + data.unit + ")", 1, {
        limits: [],
        draw: function (up, columns) {
          data.commanded.forEach(function (at) { mark(at, TOP, upper, width, "f-7a7a7a", [2, 3]); });
          data.edges.forEach(function (at) { mark(at, TOP, upper, width, "f-009e73", [6, 4]); });
          paint.setLineDash([]); paint.strokeStyle = colour("f-a01c1c"); paint.lineWidth = 1.6;
          curve(trace.model, 1, up, columns);
        }
      });
      panel(trace.r, trace.ranges.r, TOP + upper + GAP, lower, width,
        "residual (" + small[0] + ")", small[1], {
          limits: [],
          draw: function (up, columns) {
            paint.strokeStyle = colour("f-d55e00"); paint.lineWidth = 1.2; paint.setLineDash([6, 4]);
            curve(trace.sd, 2, up, columns); curve(trace.sd, -2, up, columns);
            paint.setLineDash([]);
          }
        });
      canvas.setAttribute("data-from", view[0]);
      canvas.setAttribute("data-to", view[1]);
      say();
    }
    function mark(at, top, height, width, name, dash) {
      if (at < view[0] || at > view[1]) { return; }
      paint.strokeStyle = colour(name); paint.lineWidth = 1.2; paint.setLineDash(dash);
      paint.beginPath(); paint.moveTo(place(at, width), top); paint.lineTo(place(at, width), top + height);
      paint.stroke(); paint.setLineDash([]);
    }
    function fixed(v, digits) { return v.toFixed(digits); }
    function say() {
      var digits = Math.max(0, Math.min(6, Math.ceil(1 - Math.log10(view[1] - view[0])) + 1)), text;
      var n = first(trace.t, view[1] + 1e-12) - first(trace.t, view[0]);
      text = fixed(view[0], digits) + " to " + fixed(view[1], digits) + " s, " + n + " samples";
      if (data.thinned) { text += " (thinned far from the switches)"; }
      if (pointer !== null && pointer >= view[0] && pointer <= view[1]) {
        var i = Math.min(first(trace.t, pointer), trace.t.length - 1);
        if (i > 0 && pointer - trace.t[i - 1] < trace.t[i] - pointer) { i -= 1; }
        text += "; at " + fixed(trace.t[i], Math.max(digits, 3)) + " s: measured "
          + trace.y[i].toPrecision(4) + " " + data.unit + ", residual "
          + (small[1] * trace.r[i]).toPrecision(3) + " " + small[0];
      }
      words.textContent = text;
    }

    canvas.addEventListener("wheel", function (event) {
      event.preventDefault();
      var x = event.clientX - canvas.getBoundingClientRect().left;
      if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) { move(event.deltaX / 800); } else {
        zoom(Math.pow(1.0015, Math.max(-300, Math.min(300, event.deltaY))), time(x));
      }
    }, { passive: false });
    canvas.addEventListener("pointerdown", function (event) {
      if (event.isTrusted) { canvas.setPointerCapture(event.pointerId); }
      held[event.pointerId] = event.clientX;
      reach = null;
    });
    canvas.addEventListener("pointermove", function (event) {
      var left = canvas.getBoundingClientRect().left, ids = Object.keys(held);
      if (held[event.pointerId] === undefined) {
        pointer = time(event.clientX - left); say();
        return;
      }
      var before = held[event.pointerId];
      held[event.pointerId] = event.clientX;
      if (ids.length === 1) {
        move((before - event.clientX) / (canvas.clientWidth - LEFT - RIGHT));
      } else {
        var xs = ids.map(function (id) { return held[id] - left; }), wide = Math.abs(xs[0] - xs[1]);
        if (reach) { zoom(reach / Math.max(wide, 8), time((xs[0] + xs[1]) / 2)); }
        reach = Math.max(wide, 8);
      }
    });
    ["pointerup", "pointercancel"].forEach(function (name) {
      canvas.addEventListener(name, function (event) { delete held[event.pointerId]; reach = null; });
    });
    canvas.addEventListener("pointerleave", function () { pointer = null; say(); });
    canvas.addEventListener("dblclick", function () { set(whole[0], whole[1]); });
    canvas.addEventListener("keydown", function (event) {
      var acts = {
        ArrowLeft: function () { move(-0.2); }, ArrowRight: function () { move(0.2); },
        ArrowUp: function () { zoom(0.7); }, ArrowDown: function () { zoom(1 / 0.7); },
        "+": function () { zoom(0.5); }, "=": function () { zoom(0.5); }, "-": function () { zoom(2); },
        Home: function () { set(whole[0], whole[1]); }, Escape: done
      };
      if (acts[event.key] && !event.ctrlKey && !event.metaKey && !event.altKey) {
        event.preventDefault();
        acts[event.key]();
      }
    });
    var legend = document.createElement("p");
    legend.className = "readout";
    legend.textContent = "Blue: measured; red: model; long dashes: fitted switch; dots: commanded; "
      + "below: residual with ± 2 s of the noise law. Wheel or + and − zoom, drag or arrows move.";
    [bar, canvas, words, legend].forEach(function (part) { box.appendChild(part); });
    figure.insertBefore(box, figure.querySelector(".drawing"));
    var watch = window.ResizeObserver ? new ResizeObserver(draw) : null, dark = matchMedia("(prefers-color-scheme: dark)");
    if (watch) { watch.observe(canvas); }
    dark.addEventListener("change", draw);
    draw();
    if (!quiet) { canvas.focus({ preventScroll: true }); }
    this.close = function () {
      if (watch) { watch.disconnect(); }
      dark.removeEventListener("change", draw);
      box.remove();
    };
  }

  document.querySelectorAll("figure[data-trace]").forEach(function (figure) {
    var source = document.getElementById("samples-" + figure.getAttribute("data-trace"));
    if (!source) { return; }
    var opener = document.createElement("button"), viewer = null;
    opener.type = "button"; opener.className = "opener"; opener.textContent = "Zoom, every sample";
    function toggle(event, quiet) {
      if (viewer) {
        viewer.close(); viewer = null;
        opener.focus({ preventScroll: true });
      } else { viewer = new Viewer(figure, JSON.parse(source.textContent), toggle, quiet); }
      figure.classList.toggle("zoomed", viewer !== null);
      opener.textContent = viewer ? "Back to the drawing" : "Zoom, every sample";
    }
    opener.addEventListener("click", toggle);
    figure.querySelector(".drawing").addEventListener("click", toggle);
    figure.querySelector("figcaption").appendChild(document.createTextNode(" "));
    figure.querySelector("figcaption").appendChild(opener);
    if (!figure.querySelector(".drawing svg") && window.IntersectionObserver) {
      // not drawn beforehand: as soon as it is seen, once
      var seen = new IntersectionObserver(function (entries) {
        if (!viewer && entries.some(function (entry) { return entry.isIntersecting; })) {
          seen.disconnect();
          toggle(null, true);
        }
      });
      seen.observe(figure);
    }
  });
})();
