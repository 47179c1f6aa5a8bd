// Calls to the service. Commands carry the session's CSRF word and, while this console holds it, the lease.

export const session = { needed: false, name: null, role: null, csrf: null };
export const lease = { id: null, holder: null, left_s: null };

export class Problem extends Error {
  constructor(status, facts) {
    super(facts.detail || facts.title || `HTTP ${status}`);
    this.status = status;
    this.facts = facts;
  }
}

export async function call(method, path, body) {
  const headers = { Accept: "application/json" };
  if (body !== undefined) headers["Content-Type"] = "application/json";
  if (session.csrf) headers["X-CSRF-Token"] = session.csrf;
  if (lease.id && method !== "GET") headers["Lease-Id"] = lease.id;
  const answer = await fetch(`/api/v1${path}`, {
    method,
    headers,
    body: body === undefined ? undefined : JSON.stringify(body),
    credentials: "same-origin",
  });
  const text = await answer.text();
  const kind = answer.headers.get("Content-Type") || "";
  const facts = kind.includes("json") && text ? JSON.parse(text) : { detail: text };
  if (!answer.ok) {
    if (answer.status === 401) window.dispatchEvent(new CustomEvent("signed-out"));
    throw new Problem(answer.status, facts);
  }
  return facts;
}

export const get = (path) => call("GET", path);

export async function readSession() {
  Object.assign(session, await get("/session"));
  return session;
}

export const may = (role) => ["viewer", "operator", "maintainer"].indexOf(session.role) >= ["viewer", "operator", "maintainer"].indexOf(role);

export async function takeLease(holder, takeOver, reason) {
  const got = await call("POST", "/lease", { holder, lasts_s: 30, take_over: takeOver, reason: reason || null });
  Object.assign(lease, { id: got.lease_id, holder: got.holder, left_s: 30 });
}

export async function releaseLease() {
  await call("DELETE", "/lease");
  lease.id = null;
}

export async function watchLease() {
  try {
    if (lease.id) await call("PUT", "/lease", { lasts_s: 30 });
  } catch {
    lease.id = null; // ran out or taken over: the next look says by whom
  }
  Object.assign(lease, await get("/lease"));
}
