// Plays the staged rallies of a report, each in a frame with the program of the live court.
for (const button of document.querySelectorAll("button.play")) {
  const text = button.textContent;
  button.addEventListener("click", () => {
    const open = button.nextElementSibling;
    if (open) {
      URL.revokeObjectURL(open.dataset.address);
      open.remove();
    } else {
      const { lang } = document.documentElement;
      const part = (id) => document.getElementById(id).textContent;
      const page = [
        `<!doctype html><html lang="${lang}"><head><meta charset="utf-8">`,
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        `<title></title><style>${part("viewer-style")}<\/style></head><body>`,
        `<script type="application/json" id="shared">${part("rallies")}<\/script>`,
        `<script type="module">${part("viewer-script")}<\/script></body></html>`,
      ];
      const frame = document.createElement("iframe");
      frame.title = button.closest(".card").querySelector("h3").textContent;
      frame.dataset.address = URL.createObjectURL(new Blob(page, { type: "text/html" }));
      frame.src = `${frame.dataset.address}#rally=${Number(button.dataset.rally) + 1}`;
      button.after(frame);
    }
    button.textContent = open ? text : button.dataset.close;
    button.setAttribute("aria-expanded", String(!open));
  });
}

// Probability of winning a match from those of winning a rally served and received, both between 0 and 1.
function matchChance(serving, receiving, { points, cap, games, clear }) {
  const won = (a, b) => a >= cap || (a >= points && a - b >= clear);
  const known = new Map();
  const game = (a, b, server) => {
    if (won(a, b)) return 1;
    if (won(b, a)) return 0;
    const key = (a * 64 + b) * 2 + server;
    if (!known.has(key)) {
      const p = server ? receiving : serving;
      known.set(key, p * game(a + 1, b, 0) + (1 - p) * game(a, b + 1, 1));
    }
    return known.get(key);
  };
  const match = (a, b, server) => {
    if (a === games) return 1;
    if (b === games) return 0;
    const p = game(0, 0, server);
    return p * match(a + 1, b, 0) + (1 - p) * match(a, b + 1, 1);
  };
  return (match(0, 0, 0) + match(0, 0, 1)) / 2;
}

// Sliders: changes at the steps of a table, straight lines between them, and sums over the tactics; figures are means over the spread.
const decimal = new Intl.NumberFormat(document.documentElement.lang, { minimumFractionDigits: 1, maximumFractionDigits: 1 });
for (const panel of document.querySelectorAll(".sliders")) {
  const { steps, tactics, base, spread, rules } = JSON.parse(panel.dataset.table);
  const inputs = [...panel.querySelectorAll("input")];
  const change = (values, at) => {
    const k = Math.max(1, steps.findIndex((step) => step >= at));
    const part = (at - steps[k - 1]) / (steps[k] - steps[k - 1]);
    return values[k - 1] + part * (values[k] - values[k - 1]);
  };
  const show = () => {
    const [serving, receiving] = ["serving", "receiving"].map((name) => {
      return inputs.reduce((total, input, i) => total + change(tactics[i][name], Number(input.value) / 100), base[name]);
    });
    const figures = { rally: 0, match: 0 };
    spread.at.forEach((by, i) => {
      const [served, received] = [serving, receiving].map((p) => Math.min(1, Math.max(0, p + by)));
      figures.rally += (spread.weights[i] * (served + received)) / 2;
      figures.match += spread.weights[i] * matchChance(served, received, rules);
    });
    for (const [name, value] of Object.entries(figures)) {
      panel.querySelector(`[data-figure=${name}]`).textContent = decimal.format(100 * value);
    }
    for (const input of inputs) {
      input.nextElementSibling.textContent = `${input.value > 0 ? "+" : ""}${input.value}`;
    }
  };
  panel.addEventListener("input", show);
  panel.querySelector(".reset").addEventListener("click", () => {
    for (const input of inputs) input.value = 0;
    show();
  });
  show();
}
