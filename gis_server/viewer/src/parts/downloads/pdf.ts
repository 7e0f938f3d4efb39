/** A PDF file of one page, filled by an image at its size on paper (ISO 32000-1, 7.5 and 8.9.5). */

const POINTS_PER_INCH = 72;

/** `size`: samples and lines of the JPEG image. */
export function pdfOf(
  jpeg: Uint8Array,
  size: readonly [width: number, height: number],
  dotsPerInch: number,
): Uint8Array<ArrayBuffer> {
  const [width, height] = size;
  const [wide, high] = size.map((dots) => ((dots * POINTS_PER_INCH) / dotsPerInch).toFixed(3));
  const drawing = `${wide} 0 0 ${high} 0 0 cm /Map Do`;
  const image =
    `<< /Type /XObject /Subtype /Image /Width ${width} /Height ${height} /ColorSpace /DeviceRGB ` +
    `/BitsPerComponent 8 /Filter /DCTDecode /Length ${jpeg.length} >>`;
  const page =
    `<< /Type /Page /Parent 2 0 R /MediaBox [0 0 ${wide} ${high}] /Contents 4 0 R ` +
    "/Resources << /XObject << /Map 5 0 R >> >> >>";
  const objects: readonly (readonly (string | Uint8Array)[])[] = [
    ["<< /Type /Catalog /Pages 2 0 R >>"],
    ["<< /Type /Pages /Kids [3 0 R] /Count 1 >>"],
    [page],
    [`<< /Length ${drawing.length} >>\nstream\n${drawing}\nendstream`],
    [`${image}\nstream\n`, jpeg, "\nendstream"],
  ];
  const file = new Bytes();
  file.add("%PDF-1.4\n");
  const starts = objects.map((parts, at) => {
    const start = file.length;
    file.add(`${at + 1} 0 obj\n`, ...parts, "\nendobj\n");
    return `${String(start).padStart(10, "0")} 00000 n \n`;
  });
  const table = file.length;
  const count = objects.length + 1;
  file.add(`xref\n0 ${count}\n0000000000 65535 f \n`, ...starts);
  file.add(`trailer\n<< /Size ${count} /Root 1 0 R >>\nstartxref\n${table}\n%%EOF\n`);
  return file.whole();
}

class Bytes {
  private readonly parts: Uint8Array[] = [];
  length = 0;

  add(...parts: readonly (string | Uint8Array)[]): void {
    for (const part of parts) {
      const bytes = typeof part === "string" ? new TextEncoder().encode(part) : part;
      this.parts.push(bytes);
      this.length += bytes.length;
    }
  }

  whole(): Uint8Array<ArrayBuffer> {
    const all = new Uint8Array(this.length);
    let at = 0;
    for (const part of this.parts) {
      all.set(part, at);
      at += part.length;
    }
    return all;
  }
}
