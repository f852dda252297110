/** The box that says what went wrong: in place of a picture, or beside one, and then it can be closed. */

import type { Problem } from "../problem";
import { byId } from "./controls";

export function say(problem: Problem, beside: boolean): void {
  const box = byId("message");
  box.classList.toggle("aside", beside);
  byId("message-close").hidden = !beside;
  byId("message-sentence").textContent = problem.sentence;
  byId("message-next").textContent = problem.next;
  byId("message-detail").textContent = problem.detail;
  box.hidden = false;
}

/** Have the button of the box close it, and Escape, wherever the focus is. */
export function listenToMessage(): void {
  const [box, button] = [byId("message"), byId("message-close")];
  const close = (): void => {
    if (box.contains(document.activeElement)) {
      byId("canvas").focus(); // else whoever uses the keyboard would begin anew
    }
    box.hidden = true;
  };
  button.addEventListener("click", close);
  window.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && !box.hidden && !button.hidden) {
      event.preventDefault();
      close();
    }
  });
}
