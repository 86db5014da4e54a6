// Robots, queries, server: one of them is shown.

const NAMES = ["robots", "queries", "server"];
const byId = (id) => document.getElementById(id);

export class Tabs {
  // `first`: the one to begin with, where there is one of that name.
  constructor(onChosen, first) {
    this.onChosen = onChosen;
    for (const name of NAMES) byId(`tab-${name}`).addEventListener("click", () => this.choose(name));
    byId("tabs").addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      this.choose(NAMES[(NAMES.indexOf(this.chosen) + step + NAMES.length) % NAMES.length]);
      byId(`tab-${this.chosen}`).focus();
    });
    this.choose(NAMES.includes(first) ? first : NAMES[0]);
  }

  choose(name) {
    if (!NAMES.includes(name)) return;
    this.chosen = name;
    for (const one of NAMES) {
      byId(one).hidden = one !== name;
      byId(`tab-${one}`).setAttribute("aria-selected", one === name);
      byId(`tab-${one}`).tabIndex = one === name ? 0 : -1;
    }
    byId("side").classList.toggle("is-wide", name !== NAMES[0]);
    this.onChosen(name);
  }
}
