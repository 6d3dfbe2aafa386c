// The catalogue: every text of the page by key. English stands in for what a language does not have yet.
let catalogue = {};

export async function loadTexts() {
  const reply = await fetch("/api/v1/texts");
  if (reply.ok) catalogue = await reply.json();
}

/** The text of a key with its {names} filled in; a key without text shows itself, so that it is seen. */
export function t(key, values = {}) {
  return (catalogue[key] ?? key).replace(/\{(\w+)\}/g, (whole, name) => (name in values ? values[name] : whole));
}

/** The text of a key of a family (`state.` + name), or the name itself where a newer run knows more words than this page. */
export function word(family, name) {
  return catalogue[`${family}.${name}`] ?? String(name ?? "");
}

/** A code and what it means; the text of an error begins with its code already. */
export function withCode(code, text, between) {
  return text?.startsWith(`error ${code}:`) ? text : [code, text].filter(Boolean).join(between);
}
