// Triangles into memory: what a graphics card does, for the computers that have none.

const LEAST_AREA = 1e-6; // px^2, twice: thinner ones cover no pixel

/** A picture with a depth for each pixel, and the corners of what is being drawn into it. */
export class Raster {
  width = 0;
  height = 0;
  pixels = new Uint32Array(0); // as in an ImageData of a little-endian computer
  private depth = new Float32Array(0); // -1 near, 1 far
  // Corners: place in pixels from the upper left, depth, colour 0 to 255.
  x = new Float64Array(64);
  y = new Float64Array(64);
  z = new Float64Array(64);
  r = new Float64Array(64);
  g = new Float64Array(64);
  b = new Float64Array(64);

  /** Draw into `pixels`, width x height of them. */
  resize(width: number, height: number, pixels: Uint32Array<ArrayBuffer>): void {
    [this.width, this.height, this.pixels] = [width, height, pixels];
    this.depth = new Float32Array(width * height);
  }

  /** Room for so many corners; what they were is lost. */
  reserve(n: number): void {
    if (this.x.length >= n) return;
    [this.x, this.y, this.z, this.r, this.g, this.b] = Array.from({ length: 6 }, () => new Float64Array(n)) as Float64Array<ArrayBuffer>[] as [
      Float64Array<ArrayBuffer>, Float64Array<ArrayBuffer>, Float64Array<ArrayBuffer>, Float64Array<ArrayBuffer>, Float64Array<ArrayBuffer>, Float64Array<ArrayBuffer>,
    ];
  }

  clear(pixel: number): void {
    this.pixels.fill(pixel);
    this.depth.fill(Infinity);
  }

  /**
   * The triangle of three corners, if it is seen from its front (counter-clockwise) or `isTwoSided`. A corner that is
   * no number takes it away. `alpha` below 1 lets through what is behind and hides nothing that comes later;
   * `isOver`: whatever is nearer.
   */
  triangle(a: number, b: number, c: number, isTwoSided: boolean, alpha = 1, isOver = false): void {
    const { x, y } = this;
    const area = (x[b]! - x[a]!) * (y[c]! - y[a]!) - (x[c]! - x[a]!) * (y[b]! - y[a]!);
    if (!(Math.abs(area) > LEAST_AREA) || (area > 0 && !isTwoSided)) return;
    // From the uppermost to the lowest.
    if (y[b]! < y[a]!) [a, b] = [b, a];
    if (y[c]! < y[b]!) [b, c] = [c, b];
    if (y[b]! < y[a]!) [a, b] = [b, a];
    const first = Math.max(Math.ceil(y[a]! - 0.5), 0);
    const last = Math.min(Math.ceil(y[c]! - 0.5), this.height) - 1;
    if (first > last) return;
    this.rows(a, b, c, first, last, alpha, isOver);
  }

  private rows(a: number, b: number, c: number, first: number, last: number, alpha: number, isOver: boolean): void {
    const { x, y, z, width } = this;
    const [xa, ya, xb, yb, xc, yc] = [x[a]!, y[a]!, x[b]!, y[b]!, x[c]!, y[c]!];
    const [dxb, dyb, dxc, dyc] = [xb - xa, yb - ya, xc - xa, yc - ya];
    const scale = 1 / (dxb * dyc - dxc * dyb);
    // Slopes of a quantity that is linear on the picture.
    const alongX = (v: Float64Array): number => ((v[b]! - v[a]!) * dyc - (v[c]! - v[a]!) * dyb) * scale;
    const alongY = (v: Float64Array): number => ((v[c]! - v[a]!) * dxb - (v[b]! - v[a]!) * dxc) * scale;
    const [zx, rx, gx, bx] = [alongX(z), alongX(this.r), alongX(this.g), alongX(this.b)];
    const [zy, ry, gy, by] = [alongY(z), alongY(this.r), alongY(this.g), alongY(this.b)];
    const [slopeLong, slopeUpper, slopeLower] = [dxc / dyc, dxb / dyb, (xc - xb) / (yc - yb)];
    for (let row = first; row <= last; row++) {
      const dy = row + 0.5 - ya;
      const long = xa + dy * slopeLong;
      const short = row + 0.5 < yb ? xa + dy * slopeUpper : xb + (row + 0.5 - yb) * slopeLower;
      const from = Math.max(Math.ceil((long < short ? long : short) - 0.5), 0);
      const to = Math.min(Math.ceil((long < short ? short : long) - 0.5), width);
      if (from >= to) continue;
      const dx = from + 0.5 - xa;
      const at = row * width;
      const [z0, r0, g0, b0] = [z[a]! + dx * zx + dy * zy, this.r[a]! + dx * rx + dy * ry, this.g[a]! + dx * gx + dy * gy, this.b[a]! + dx * bx + dy * by];
      if (alpha === 1 && !isOver) this.span(at + from, at + to, z0, zx, r0, rx, g0, gx, b0, bx);
      else this.mixedSpan(at + from, at + to, z0, zx, r0, g0, b0, alpha, isOver);
    }
  }

  private span(from: number, to: number, z: number, zx: number, r: number, rx: number, g: number, gx: number, b: number, bx: number): void {
    const { depth, pixels } = this;
    for (let i = from; i < to; i++) {
      if (z < depth[i]!) {
        depth[i] = z;
        pixels[i] = 0xff000000 | (b << 16) | (g << 8) | r;
      }
      z += zx;
      r += rx;
      g += gx;
      b += bx;
    }
  }

  /** One colour for the row: what is seen through is of one colour anyway. */
  private mixedSpan(from: number, to: number, z: number, zx: number, r: number, g: number, b: number, alpha: number, isOver: boolean): void {
    const { depth, pixels } = this;
    const rest = 1 - alpha;
    for (let i = from; i < to; i++, z += zx) {
      if (!isOver && z >= depth[i]!) continue;
      const p = pixels[i]!;
      pixels[i] = 0xff000000 | ((b * alpha + ((p >> 16) & 255) * rest) << 16) | ((g * alpha + ((p >> 8) & 255) * rest) << 8) | (r * alpha + (p & 255) * rest);
    }
  }
}
