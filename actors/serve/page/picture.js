// The picture: frames are decoded in order and drawn when the browser paints.

import { now } from "./connection.js";

export class Picture {
  // `shown(frame)`: it is on the canvas.
  constructor(canvas, shown) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.shown = shown;
    this.last = Promise.resolve();
    this.latencies = canvas.latencies = [];
    this.bytes = [];
  }

  take(frame) {
    this.bytes.push([now(), frame.bytes.length]);
    const decoded = createImageBitmap(new Blob([frame.bytes], { type: frame.lossless ? "image/webp" : "image/jpeg" }),
      { colorSpaceConversion: "none", premultiplyAlpha: "none" }).catch(() => null);
    this.last = this.last.then(async () => {
      const image = await decoded;
      // A hidden page paints nothing, so nothing more is sent to it.
      await new Promise(requestAnimationFrame);
      const { canvas, context } = this;
      if (canvas.width !== frame.width || canvas.height !== frame.height) {
        canvas.width = frame.width;
        canvas.height = frame.height;
        canvas.parentElement.style.setProperty("--ratio", frame.width / frame.height);
      }
      if (image) {
        const { tiles, columns, side } = frame;
        const own = image.width / (columns || 1);
        tiles.forEach(([x, y], i) => context.drawImage(
          image, i % columns * own, Math.floor(i / columns) * own, own, own, x, y, side, side));
        if (!tiles.length) context.drawImage(image, 0, 0, frame.width, frame.height);
        image.close();
        if (!this.first) performance.mark(this.first = "first picture");
      }
      if (frame.mark && frame.mark !== this.mark) {
        this.mark = frame.mark;
        const latency = now() - frame.mark;
        this.latencies.push([latency, latency - frame.took]);
        if (this.latencies.length > 60) this.latencies.shift();
      }
      this.shown(frame, Boolean(image));
    });
  }

  // Median time from input to canvas, all of it and without the walk's, ms; kilobits a second of the last two.
  measured() {
    const middle = (part) => this.latencies.map((both) => both[part]).sort((a, b) => a - b)[this.latencies.length >> 1];
    this.bytes = this.bytes.filter(([at]) => now() - at < 2000);
    return {
      latency: this.latencies.length && [0, 1].map(middle),
      rate: this.bytes.reduce((sum, [, bytes]) => sum + bytes, 0) * 8 / 2000,
    };
  }
}
