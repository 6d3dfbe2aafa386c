// Runs before the page is drawn, so that nobody sees the other theme flash by. Dark is the default.
(function () {
  let theme = null;
  try { theme = localStorage.getItem("bench.theme"); } catch { /* no storage: the wish of the system counts */ }
  const light = window.matchMedia("(prefers-color-scheme: light)").matches;
  document.documentElement.dataset.theme = theme === "light" || theme === "dark" ? theme : light ? "light" : "dark";
})();
