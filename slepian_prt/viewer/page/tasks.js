// Long work in pieces, between which the page answers.

// Milliseconds of work at a time: half a frame at 60 Hz.
const LONGEST_PIECE = 8;

/** Waits until the browser has handled what is waiting; `scheduler.yield` would let this go before timers. */
function pause() {
  const { port1, port2 } = new MessageChannel();
  return new Promise(resolve => {
    port1.onmessage = resolve;
    port2.postMessage(null);
  });
}

/**
 * Does something for 0 … count-1, and lets the page answer now and then.
 *
 * @param {number} count
 * @param {(i: number) => void} step Takes well under a millisecond, or the page stutters.
 */
export async function inPieces(count, step) {
  let begun = performance.now();
  for (let i = 0; i < count; i++) {
    step(i);
    if (performance.now() - begun > LONGEST_PIECE) {
      await pause();
      begun = performance.now();
    }
  }
}
