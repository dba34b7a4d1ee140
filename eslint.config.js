// Mistakes, not style. No imports, so that eslint itself is all that is needed (make lint).

const browser = [
  ...["AbortController", "Blob", "CustomEvent", "Event", "EventTarget", "MessageChannel", "ResizeObserver", "TextDecoder"],
  ...["TextEncoder", "URL", "WebSocket", "WebTransport", "XRRigidTransform", "addEventListener", "btoa", "clearInterval", "clearTimeout"],
  ...["console", "crypto", "devicePixelRatio", "document", "fetch", "getComputedStyle", "globalThis", "innerHeight"],
  ...["innerWidth", "location", "matchMedia", "navigator", "performance", "queueMicrotask", "requestAnimationFrame"],
  ...["sessionStorage", "setInterval", "setTimeout", "localStorage", "AudioContext", "GainNode", "OscillatorNode"],
  ...["Image", "RTCPeerConnection", "atob"],
];
const readonly = (names) => Object.fromEntries(names.map((name) => [name, "readonly"]));

const rules = Object.fromEntries(
  [
    ...["array-callback-return", "constructor-super", "eqeqeq", "for-direction", "getter-return", "no-async-promise-executor"],
    ...["no-await-in-loop", "no-class-assign", "no-compare-neg-zero", "no-cond-assign", "no-const-assign"],
    ...["no-constant-condition", "no-debugger", "no-dupe-args", "no-dupe-class-members", "no-dupe-else-if", "no-dupe-keys"],
    ...["no-duplicate-case", "no-duplicate-imports", "no-eval", "no-fallthrough", "no-func-assign", "no-implied-eval"],
    ...["no-import-assign", "no-irregular-whitespace", "no-loss-of-precision", "no-new-func", "no-promise-executor-return"],
    ...["no-redeclare", "no-self-assign", "no-self-compare", "no-shadow-restricted-names", "no-sparse-arrays"],
    ...["no-this-before-super", "no-undef", "no-unreachable", "no-unsafe-finally", "no-unsafe-negation"],
    ...["no-unsafe-optional-chaining", "no-unused-private-class-members", "no-unused-vars", "no-use-before-define"],
    ...["no-useless-catch", "no-var", "prefer-const", "require-yield", "use-isnan", "valid-typeof"],
  ].map((name) => [name, "error"]),
);
Object.assign(rules, {
  "no-use-before-define": ["error", { functions: false, classes: false, variables: false }],
  "no-await-in-loop": "off",
  "no-promise-executor-return": "off",
  // Whatever others have said is text: nothing may make markup of it.
  "no-restricted-properties": [
    "error",
    ...["innerHTML", "outerHTML", "insertAdjacentHTML"].map((property) => ({ property })),
    { object: "document", property: "write" },
  ],
});

export default [
  { ignores: ["**/vendor/**", "**/node_modules/**", "build/**", ".venv/**"] },
  {
    files: ["synchronizar/live/pages/**/*.js", "synchronizar/reporting/**/*.js", "synchronizar/apps/*/pages/**/*.js", "examples/*/*/pages/**/*.js"],
    languageOptions: { ecmaVersion: 2023, sourceType: "module", globals: readonly(browser) },
    rules,
  },
  {
    files: ["tests/**/*.js", "examples/**/*.js"],
    languageOptions: { ecmaVersion: 2023, sourceType: "module", globals: readonly([...browser, "Buffer", "TransformStream", "process"]) },
    rules,
  },
];
