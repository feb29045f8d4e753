/** Sentences that appear for a while, and are read out. */

const SHOWN = 9000;

/** Say a sentence; it can be closed before it goes. */
export function notify(text) {
  const line = document.createElement("p");
  const words = document.createElement("span");
  const close = document.createElement("button");
  words.textContent = text;
  close.type = "button";
  close.textContent = "×";
  close.setAttribute("aria-label", "Close");
  line.append(words, close);
  const remove = () => line.remove();
  close.addEventListener("click", remove);
  setTimeout(remove, SHOWN);
  const place = document.getElementById("notices");
  while (place.children.length > 2) place.firstChild.remove();
  place.append(line);
}

/** A sentence in the place of the picture. */
export function stopWith(text) {
  const message = document.getElementById("message");
  message.textContent = text;
  message.hidden = false;
  document.getElementById("stage").hidden = true;
  document.getElementById("panel").hidden = true;
}
