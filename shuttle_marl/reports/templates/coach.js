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
