/** Pictures and links that one takes along. */

/** Save the picture as it is seen, finished, as .png; without a background it is transparent. */
export async function savePicture(viewer) {
  const { film } = viewer.payload;
  const [width, height] = film ? [film.width, film.height] : viewer.pixels;
  const picture = await viewer.takePicture({ width, height });
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  canvas.getContext("2d").putImageData(picture, 0, 0);
  const blob = await new Promise((resolve) => { canvas.toBlob(resolve, "image/png"); });
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `${viewer.payload.title.replace(/[^\w.-]+/g, "_")}.png`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

/** Copy the address, which holds what is chosen. */
export async function copyLink(hash, report) {
  const address = `${location.href.replace(/#.*$/, "")}${hash ? `#${hash}` : ""}`;
  try {
    await navigator.clipboard.writeText(address);
    report("The link is copied.");
  } catch {
    prompt("Copy this link:", address);
  }
}
