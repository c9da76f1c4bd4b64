import { FileSource } from "./source.js";
import { Stage } from "./stage.js";
import { makeTablesSortable } from "./tables.js";

/** Brings a report to life: its tables can be sorted, and its room turned. */
export function startReport() {
  makeTablesSortable(document);
  const place = document.querySelector("[data-source=file]");
  if (!place) return;
  const stage = new Stage(place.querySelector("[data-stage]"), new FileSource());
  place.stage = stage;
  stage.start().catch((error) => stage.say(error.message));
}
