// Everything the page sends to the server but questions: JSON, with the header no foreign page can set.
import { t } from "./texts.js";

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
