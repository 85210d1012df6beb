// A page that a server feeds: it shows simulations as they finish, and leaves the reader where they are.

/** Time between two questions to the server, milliseconds. */
const POLL_MS = 1500;

/** What an incomplete run that nobody writes needs. */
const STOPPED = "No process writes this run. planagent simulate --resume RUN goes on";

class Follower {
  /** `node` says how far the runs are, or that the server has ended. */
  constructor(node) {
    this.node = node;
    /** Whether the overview is older than the index. */
    this.stale = false;
  }

  /** Asks for ever; not while nobody sees the page. */
  async follow() {
    for (;;) {
      if (!document.hidden) await this.look().catch((error) => this.lost(error));
      await new Promise((resolve) => { setTimeout(resolve, POLL_MS); });
    }
  }

  async look() {
    const { version, simulations, planned, running, problem } = await received("version");
    if (version !== INDEX.version) await this.update();
    else if (this.stale) this.showOverview();
    const unreadable = INDEX.unreadable.length ? [`Not readable: ${INDEX.unreadable.join("; ")}`] : [];
    const troubles = [problem, ...unreadable].filter(Boolean);
    const stopped = !running && simulations < planned;
    const state = running ? "live" : stopped ? "stopped" : "complete";
    this.say(troubles.length ? "doubtful" : state, `${state} · ${simulations < planned ? `${simulations} of` : "all"} ${planned}`,
      [`${simulations} of ${planned} simulations`, stopped ? STOPPED : null, ...troubles].filter(Boolean).join(". "));
  }

  /** Shows the present data in all views. */
  async update() {
    const waited = INDEX.simulations.length === 0;
    await loadIndex();
    showAbout();
    if (!INDEX.simulations.length) return void showWaiting();
    if (waited && !scenarios) return void await showViews();
    this.showOverview();
    histograms.forget();
    if (document.body.dataset.view === "histograms") await histograms.show();
    await scenarios.refresh();
  }

  /** An open menu would close, so it waits for it. */
  showOverview() {
    const overview = document.getElementById("overview");
    this.stale = overview.contains(document.activeElement) && document.activeElement.matches("select");
    if (!this.stale) showOverview(overview);
  }

  lost(error) {
    // A failure to fetch has no words of the server.
    const ended = error instanceof TypeError;
    this.say("lost", ended ? "not live" : "error", ended ? "The server has ended, or cannot be reached. Start planagent serve again." : error.message);
    if (!ended) console.error(error);
  }

  say(state, words, title) {
    this.node.hidden = false;
    this.node.dataset.state = state;
    this.node.title = title;
    if (this.node.textContent !== words) this.node.textContent = words;
  }
}
