// An image that is given to the page: where was it taken, or why is it not recognized?

// As the server has it.
const MAX_BYTES = 4 << 20;
const OTHER = "other";

const byId = (id) => document.getElementById(id);

// The size of an image, null for what the browser cannot read; the server says why.
async function sizeOf(file) {
  try {
    // As it is stored: the server does not turn images either.
    const picture = await createImageBitmap(file, { imageOrientation: "none" });
    const size = [picture.width, picture.height];
    picture.close();
    return size;
  } catch {
    return null;
  }
}

function describe({ width, height, focal, keyframes }) {
  const images = `${keyframes.toLocaleString("en")} keyframe${keyframes === 1 ? "" : "s"}`;
  return `${width} × ${height}, f ${focal[0].toFixed(0)} px (${images})`;
}

export class ImageQuery {
  // `mapName()`: of the map that is shown, null for none; `onGiven()`: an image was given; `onAnswer(query)`: it was searched.
  constructor({ mapName, onGiven, onAnswer }) {
    Object.assign(this, { mapName, onGiven, onAnswer });
    this.isOffered = false;
    this.cameras = [];
    this.file = null;
    this.isBusy = false;
    this.camera = byId("image-camera");
    this.camera.addEventListener("change", () => this.showCalibration());
    byId("image-file").addEventListener("change", ({ target }) => {
      this.give(target.files[0]);
      // So that the same file can be chosen again.
      target.value = "";
    });
    byId("image-again").addEventListener("click", () => this.search());
    this.bindDrop();
  }

  bindDrop() {
    const isFile = (event) => this.isOffered && [...(event.dataTransfer?.types ?? [])].includes("Files");
    const mark = (isOver) => document.documentElement.classList.toggle("is-dropping", isOver);
    window.addEventListener("dragover", (event) => {
      if (!isFile(event)) return;
      event.preventDefault();
      mark(true);
    });
    window.addEventListener("dragleave", (event) => {
      if (!event.relatedTarget) mark(false);
    });
    window.addEventListener("drop", (event) => {
      mark(false);
      if (!isFile(event)) return;
      event.preventDefault();
      this.give(event.dataTransfer.files[0]);
    });
  }

  // Whether the server searches images, and for which cameras.
  async offer(isOffered) {
    const name = this.mapName();
    this.isOffered = isOffered && name !== null;
    byId("image-query").hidden = !this.isOffered;
    if (!this.isOffered) return;
    const response = await fetch(`api/maps/${encodeURIComponent(name)}/cameras`);
    const { cameras } = response.ok ? await response.json() : { cameras: [] };
    if (name !== this.mapName()) return;
    const chosen = this.camera.value;
    this.cameras = cameras;
    const options = cameras.map((camera) => new Option(describe(camera), camera.number));
    this.camera.replaceChildren(...options, new Option("another camera …", OTHER));
    if ([...this.camera.options].some(({ value }) => value === chosen)) this.camera.value = chosen;
    this.showCalibration();
  }

  showCalibration() {
    byId("image-calibration").hidden = this.camera.value !== OTHER;
  }

  say(text, kind = "") {
    byId("image-status").textContent = text;
    byId("image-status").className = kind;
  }

  async give(file) {
    if (!file) return;
    this.onGiven();
    this.file = file;
    byId("image-again").hidden = false;
    if (file.size > MAX_BYTES) {
      this.say(`${file.name} has ${(file.size / 2 ** 20).toFixed(1)} MiB, more than 4: save it with stronger compression.`, "failed");
      return;
    }
    const size = await sizeOf(file);
    const fits = ({ width, height }) => size && width === size[0] && height === size[1];
    const chosen = this.cameras[Number(this.camera.value)];
    const better = this.cameras.find(fits);
    if (chosen && better && !fits(chosen)) {
      this.camera.value = better.number;
      this.showCalibration();
    }
    await this.search();
  }

  async search() {
    const name = this.mapName();
    if (!this.file || this.isBusy || name === null) return;
    const isOther = this.camera.value === OTHER;
    const calibration = byId("image-calibration").value;
    if (isOther && !calibration.trim()) {
      this.say("Paste the camera's sensor.yaml, or a camera chain of Kalibr.", "failed");
      return;
    }
    const parameters = isOther ? { calibration } : { camera: this.camera.value };
    // As `%20`: the server takes `+` for what it is.
    const query = Object.entries(parameters).map(([key, value]) => `${key}=${encodeURIComponent(value)}`).join("&");
    this.isBusy = true;
    this.say(`Searching for ${this.file.name} …`);
    try {
      const response = await fetch(`api/maps/${encodeURIComponent(name)}/localize?${query}`, { method: "POST", body: this.file });
      const answer = await response.json();
      if (response.ok) {
        this.say(`${this.file.name}:`);
        this.onAnswer(answer);
      } else {
        this.say(`${this.file.name}: ${answer.error}`, "failed");
      }
    } catch (error) {
      this.say(`${this.file.name} could not be sent: ${error.message}`, "failed");
    } finally {
      this.isBusy = false;
    }
  }
}
