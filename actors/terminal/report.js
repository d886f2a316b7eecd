// Two pictures of one view under a line that can be drawn aside, and how they differ. Without this, they stand one below the other.
for (const ab of document.querySelectorAll(".ab")) {
  const [stage, layers] = [ab.querySelector(".stage"), ab.querySelector(".layers")];
  const [under, over] = layers.querySelectorAll("img");
  const [cut, which, zoom] = [ab.querySelector(".cut"), ab.querySelector(".which"), ab.querySelector(".zoom")];
  const all = JSON.parse(ab.querySelector("script").textContent);
  const said = ab.querySelector(".said");
  const show = () => {
    const mode = ab.querySelector("input[type=radio]:checked").value;
    const one = all[which.value];
    under.src = mode === "flip" ? one.flip : mode === "shown" ? one.shown : ab.dataset.reference;
    over.src = one.shown;
    under.alt = mode === "flip" ? "FLIP" : mode === "shown" ? one.title : "reference";
    over.hidden = mode !== "split";
    layers.classList.toggle("split", mode === "split");
    cut.disabled = mode !== "split";
    said.textContent = one.caption;
  };
  const move = () => layers.style.setProperty("--cut", cut.value / 10 + "%");
  const drag = (event) => {
    if (!(event.buttons & 1) || event.pointerType === "touch" && zoom.value > 1) return;
    const box = layers.getBoundingClientRect();
    cut.value = (1000 * (event.clientX - box.left)) / box.width;
    move();
  };
  ab.classList.add("live");
  ab.addEventListener("change", show);
  cut.addEventListener("input", move);
  stage.addEventListener("pointerdown", drag);
  stage.addEventListener("pointermove", drag);
  stage.addEventListener("dragstart", (event) => event.preventDefault());
  zoom.addEventListener("change", () => {
    const middle = (stage.scrollLeft + stage.clientWidth / 2) / stage.scrollWidth;
    const height = (stage.scrollTop + stage.clientHeight / 2) / stage.scrollHeight;
    ab.style.setProperty("--zoom", zoom.value);
    stage.scrollLeft = middle * stage.scrollWidth - stage.clientWidth / 2;
    stage.scrollTop = height * stage.scrollHeight - stage.clientHeight / 2;
  });
  show();
  move();
}
