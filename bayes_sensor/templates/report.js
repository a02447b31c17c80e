"use strict";
(function () {
  function value(cell) {
    var text = cell.getAttribute("data-v");
    var number = Number(text);
    return text !== "" && !Number.isNaN(number) ? number : text;
  }
  function compare(a, b) {
    var blankA = a === "", blankB = b === "";
    if (blankA || blankB) { return blankA - blankB; }
    if (typeof a === "number" && typeof b === "number") { return a - b; }
    return String(a).localeCompare(String(b), "en", { numeric: true });
  }
  document.querySelectorAll("button.sort").forEach(function (button) {
    button.addEventListener("click", function () {
      var head = button.closest("th"), table = button.closest("table");
      var column = Array.prototype.indexOf.call(head.parentNode.children, head);
      var down = head.getAttribute("aria-sort") === "ascending";
      table.querySelectorAll("thead th").forEach(function (th) { th.removeAttribute("aria-sort"); });
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      var body = table.tBodies[0], rows = Array.prototype.slice.call(body.rows);
      rows.sort(function (a, b) {
        var order = compare(value(a.cells[column]), value(b.cells[column]));
        return down ? -order : order;
      });
      rows.forEach(function (row) { body.appendChild(row); });
    });
  });
  function csv(table) {
    function field(text) {
      return /[",\n]/.test(text) ? '"' + text.replace(/"/g, '""') + '"' : text;
    }
    return Array.prototype.map.call(table.rows, function (row) {
      return Array.prototype.map.call(row.cells, function (cell) {
        var text = cell.hasAttribute("data-v") ? cell.getAttribute("data-v") : cell.textContent.trim();
        // a spreadsheet must not take a name for a formula
        return field(/^[=@+\-]/.test(text) && Number.isNaN(Number(text)) ? "'" + text : text);
      }).join(",");
    }).join("\n") + "\n";
  }
  function copied(button, ok) {
    var before = "Copy as CSV";
    button.textContent = ok ? "Copied" : "Copying was refused";
    setTimeout(function () { button.textContent = before; }, 1600);
  }
  function copyByHand(text) {
    var area = document.createElement("textarea");
    area.value = text;
    document.body.appendChild(area);
    area.select();
    var ok = document.execCommand("copy");
    area.remove();
    return ok;
  }
  document.querySelectorAll("button.copy").forEach(function (button) {
    button.addEventListener("click", function () {
      var text = csv(document.getElementById("table-" + button.getAttribute("data-table")));
      if (navigator.clipboard && window.isSecureContext) {
        navigator.clipboard.writeText(text).then(
          function () { copied(button, true); },
          function () { copied(button, copyByHand(text)); });
      } else { copied(button, copyByHand(text)); }
    });
  });
  window.addEventListener("beforeprint", function () {
    document.querySelectorAll("details.note").forEach(function (d) { d.open = true; });
  });
  function reveal() {
    // what a link leads to may be folded
    var goal = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    for (var d = goal; d; d = d.parentElement) { if (d.tagName === "DETAILS") { d.open = true; } }
    if (goal) { goal.scrollIntoView(); }
  }
  window.addEventListener("hashchange", reveal);
  document.addEventListener("click", function (event) {
    var link = event.target.closest("a[href^='#']");
    if (link && link.hash === location.hash) { reveal(); }
  });
  reveal();
  document.documentElement.setAttribute("data-ready", "yes");
})();
