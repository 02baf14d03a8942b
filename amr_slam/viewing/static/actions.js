// Operator actions: each asks once, does what it asked about, and shows the reply.

const name = (label, value) => ({ key: "name", label, value, pattern: "[A-Za-z0-9][A-Za-z0-9_.\\-]{0,63}", hint: "letters, digits, _ - ." });
const number = (key, label, value, digits) => ({ key, label, type: "number", value: value.toFixed(digits), step: 10 ** -digits });
const today = () => new Date().toISOString().slice(0, 10);
const mapName = (robot) => robot.status?.map?.name ?? "hall";

// `fields(robot, given)`: what is asked for; `steps(values)`: the commands, one after another.
export const ACTIONS = {
  set_pose: {
    label: "Set pose",
    verb: "Search there",
    asks: "The robot searches around this place and takes what it finds. It stays where it is when nothing fits.",
    fields: (robot, given) => [
      number("x", "x, m", given.x, 3),
      number("y", "y, m", given.y, 3),
      number("theta", "Heading, °", (180 / Math.PI) * given.theta, 1),
      { ...number("radius", "Within, m", 2, 1), min: 0.1, max: 10 },
    ],
    steps: ({ x, y, theta, radius }) => [["set_pose", { x, y, theta: (Math.PI / 180) * theta, radius }]],
  },
  relocalize: {
    label: "Relocalize",
    asks: "The robot forgets its pose and searches the whole map. It has no pose to drive by meanwhile.",
    fields: () => [],
    steps: () => [["relocalize", {}]],
  },
  start_mapping: {
    label: "Start mapping",
    asks: "The robot begins a new map here; the map it uses now is not changed. Drive it through the hall.",
    fields: () => [name("Name of the new map", `hall-${today()}`)],
    steps: (values) => [["start_mapping", { name: values.name }]],
  },
  extend_map: {
    label: "Extend map",
    asks: "The robot must be localized. From now on what it sees that is not in its map yet joins the map.",
    fields: (robot) => [
      { ...name("Map", mapName(robot)), readOnly: true },
      { key: "hold", label: "Leave the old part as it is", type: "checkbox", required: false, checked: true },
    ],
    steps: ({ name: map, hold }) => [["start_mapping", { name: map, extend: true, hold }]],
  },
  end_mapping: {
    label: "End mapping",
    asks: "The map is saved under this name, and the robot localizes in it from now on.",
    fields: (robot) => [name("Name of the map", mapName(robot))],
    steps: (values) => [["save_map", { name: values.name }], ["load_map", { name: values.name }]],
  },
  save_map: {
    label: "Save map",
    asks: "The active map is saved on the robot under this name.",
    fields: (robot) => [name("Name of the map", mapName(robot))],
    steps: (values) => [["save_map", { name: values.name }]],
  },
  save_recording: {
    label: "Save recording",
    asks: "What the last minutes brought is saved on the robot.",
    fields: () => [{ key: "reason", label: "Reason", value: "seen-in-view", pattern: "[A-Za-z0-9_\\-]{1,40}", hint: "letters, digits, _ -" }],
    steps: (values) => [["save_recording", { reason: values.reason }]],
  },
};

function make(kind, properties = {}, ...children) {
  const element = Object.assign(document.createElement(kind), properties);
  element.append(...children);
  return element;
}

/** Ask about an action on a robot, do it, and show what came of it. */
export function ask(dialog, link, robot, key, given) {
  const action = ACTIONS[key];
  const inputs = new Map();
  const form = make("form", { method: "dialog" });
  form.append(make("h2", { id: "dialog-title", textContent: `${action.label}: ${robot.robot}` }), make("p", { textContent: action.asks }));
  for (const field of action.fields(robot, given)) {
    const { key: id, label, hint, ...properties } = field;
    const input = make("input", { type: "text", required: true, autocomplete: "off", title: hint ?? "", ...properties });
    input.name = id;
    inputs.set(id, input);
    form.append(make("label", {}, make("span", { textContent: label }), input));
  }
  const reply = make("output", { className: "reply" });
  const cancel = make("button", { type: "button", textContent: "Cancel", onclick: () => dialog.close() });
  const go = make("button", { type: "submit", className: "primary", textContent: action.verb ?? action.label });
  form.append(reply, make("div", { className: "buttons" }, cancel, go));
  form.onsubmit = async (event) => {
    event.preventDefault();
    const values = Object.fromEntries([...inputs].map(([id, input]) => [id, valueOf(input)]));
    go.disabled = true;
    for (const input of inputs.values()) input.disabled = true;
    tell(reply, "waits", "Waiting for the robot …");
    let answer = null;
    for (const [command, args] of action.steps(values)) {
      answer = await link.command(robot.robot, command, args);
      if (!answer.ok) break;
    }
    tell(reply, answer.ok ? "ok" : "alarm", answer.ok ? `Done. ${what(answer)}` : `Not done: ${answer.error}`);
    cancel.textContent = "Close";
    cancel.focus();
    go.remove();
  };
  show(dialog, form);
}

function valueOf(input) {
  if (input.type === "checkbox") return input.checked;
  return input.type === "number" ? input.valueAsNumber : input.value;
}

/** Ask for a token. */
export function askToken(dialog, link, why) {
  const input = make("input", { type: "password", required: true, autocomplete: "off", name: "token" });
  const form = make("form", { method: "dialog" },
    make("h2", { id: "dialog-title", textContent: "Token" }),
    make("p", { textContent: why }),
    make("label", {}, make("span", { textContent: "Token" }), input),
    make("div", { className: "buttons" },
      make("button", { type: "button", textContent: "Cancel", onclick: () => dialog.close() }),
      make("button", { type: "submit", className: "primary", textContent: "Use it" })),
  );
  form.onsubmit = () => {
    link.token = input.value.trim();
  };
  show(dialog, form);
}

function show(dialog, form) {
  dialog.replaceChildren(form);
  if (!dialog.open) dialog.showModal();
  (form.querySelector("input") ?? form.querySelector(".primary")).focus();
}

function tell(output, kind, text) {
  output.className = `reply ${kind}`;
  output.textContent = text;
}

function what({ pose, map, file }) {
  const said = [];
  if (pose) said.push(`It is at ${pose.x.toFixed(3)}, ${pose.y.toFixed(3)} m, ${((180 / Math.PI) * pose.theta).toFixed(1)}°.`);
  if (map) said.push(`Map ${map.name}, version ${map.version}.`);
  if (file) said.push(file);
  return said.join(" ");
}
