// What stands around every page, and what it sends to the server.
import { byId, remember, say, setTimeForm, shortcutsOn, t, timeForm, turnTheme } from "./base.js";

// Everything the page sends to the server but questions: JSON, with the header no foreign page can set.

/** {ok, text, said}: whether it was done, the answer in words, the whole answer. */
export async function post(address, body) {
  try {
    const reply = await fetch(address, {
      method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json", "X-Bench-Command": "1" } });
    const said = await reply.json().catch(() => ({}));
    return { ok: reply.ok && said.ok !== false, text: said.text ?? `HTTP ${reply.status}`, said };
  } catch {
    return { ok: false, text: t("command.unanswered"), said: {} };
  }
}

/** Who is logged in, and whether the command is theirs: {name, role, is_operator}. Throws if the server does not say. */
export async function person() {
  const reply = await fetch("/api/v1/session");
  if (!reply.ok) throw new Error(`HTTP ${reply.status}`);
  return reply.json();
}

// What both pages have in common: settings, who is logged in, keys of the whole page.

const FORMS = ["utc", "local"];

export function wireSettings() {
  const select = byId("time-form");
  select.value = timeForm();
  if (!select.value) { select.value = "utc"; setTimeForm("utc"); }
  select.addEventListener("change", () => setTimeForm(select.value));
  byId("theme").addEventListener("click", turnTheme);
  byId("shortcuts").checked = shortcutsOn();
  byId("shortcuts").addEventListener("change", () => remember("shortcuts", byId("shortcuts").checked ? "on" : "off"));
  byId("language")?.addEventListener("change", () => {
    document.cookie = `language=${byId("language").value}; path=/; max-age=31536000; samesite=strict`;
    location.reload();
  });
  byId("logout").addEventListener("click", async () => { await post("/logout", {}); location.assign("/"); });
}

/** Keys of the whole page: u, d, and those given. None of them commands the run, and all of them can be turned off. */
export function wireKeys(keys = {}) {
  const all = {
    d: turnTheme,
    u: () => {
      const select = byId("time-form");
      select.value = FORMS[(FORMS.indexOf(timeForm()) + 1) % FORMS.length];
      setTimeForm(select.value);
    },
    ...keys,
  };
  addEventListener("keydown", (event) => {
    const typing = event.target.closest?.("input, select, textarea, dialog");
    if (!shortcutsOn() || typing || event.ctrlKey || event.altKey || event.metaKey || !all[event.key]) return;
    event.preventDefault();
    all[event.key]();
  });
}

/** Shows who is logged in, and returns them. */
export async function greet() {
  const found = await person().catch(() => ({ name: "", role: "viewer", is_operator: false }));
  if (found.name) say(byId("person"), t("settings.person", { name: found.name, role: t(`role.${found.role}`) }));
  return found;
}
