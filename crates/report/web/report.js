import { FileSource } from "./source.js";
import { Stage } from "./stage.js";
import { makeTablesSortable } from "./tables.js";

/** Makes the tables of a report sortable and starts its 3D view. */
export function startReport() {
  makeTablesSortable(document);
  const place = document.querySelector("[data-source=file]");
  if (!place) return;
  const stage = new Stage(place.querySelector("[data-stage]"), new FileSource());
  place.stage = stage;
  stage.start().catch((error) => stage.say(error.message));
}
