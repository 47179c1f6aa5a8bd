// What the service says as it happens, and whether it still says anything.
//
// The service sends at least five events a second. Silence for longer than SILENT_MS is shown as STALE, whatever the
// last words were: the page must not look good because nothing contradicts it.

export const SILENT_MS = 600;
const KINDS = ["status", "progress", "state", "condition", "lease", "samples", "discrepancy", "heartbeat"];

class Live extends EventTarget {
  constructor() {
    super();
    this.status = null;
    this.heardMs = -Infinity;
    this.source = null;
    this.samples = [];
    this.log = [];
    this.wasStale = null;
    setInterval(() => this.watch(), 50);
  }

  start() {
    if (this.source) this.source.close();
    this.source = new EventSource("/api/v1/events");
    for (const kind of KINDS) this.source.addEventListener(kind, (event) => this.take(kind, JSON.parse(event.data)));
    this.source.onerror = () => {
      if (this.source.readyState === EventSource.CLOSED) setTimeout(() => this.start(), 1000);
    };
  }

  stop() {
    if (this.source) this.source.close();
    this.source = null;
    this.heardMs = -Infinity;
  }

  take(kind, data) {
    this.heardMs = performance.now();
    if (kind === "status" || kind === "progress") this.status = data;
    if (kind === "state") {
      this.status = data.status;
      this.note(data.utc, `${data.source} → ${data.target}`, data.detail ? `${data.reason}: ${data.detail}` : data.reason);
    }
    if (kind === "condition") this.note(data.since, `${data.name}: ${data.state}`, data.text);
    if (kind === "lease") this.note(new Date().toISOString(), "lease", data.holder ? `held by ${data.holder}` : "released");
    if (kind === "samples") {
      this.samples.push(data);
      if (this.samples.length > 300) this.samples.shift();
    }
    this.dispatchEvent(new CustomEvent(kind, { detail: data }));
    if (kind !== "samples") this.dispatchEvent(new Event("change"));
  }

  note(utc, what, why) {
    this.log.unshift({ utc, what, why });
    if (this.log.length > 200) this.log.pop();
  }

  get silentMs() {
    return performance.now() - this.heardMs;
  }

  // Why what is shown is no longer true; null while it is.
  get stale() {
    if (this.silentMs > SILENT_MS) return "silent";
    const status = this.status;
    if (!status || status.link === "STREAMING") return null;
    return status.link === "STALE" || status.age_s !== null ? "line" : null;
  }

  watch() {
    const stale = this.stale;
    if (stale === this.wasStale) return;
    this.wasStale = stale;
    this.dispatchEvent(new Event("change"));
  }
}

export const live = new Live();
