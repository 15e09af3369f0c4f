// viser warns of WebGL without a graphics card in a box over our texts.
document.head.insertAdjacentHTML("beforeend", "<style>.mantine-Notifications-root { display: none; }</style>");
// Before viser starts: without a graphics card, draw fewer pixels and none of them several times.
(() => {
  const probe = document.createElement("canvas").getContext("webgl2");
  const info = probe && probe.getExtension("WEBGL_debug_renderer_info");
  const name = info ? probe.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  const query = new URLSearchParams(location.search);
  if (!/swiftshader|llvmpipe|softpipe|software/i.test(name) || query.has("fixedDpr")) return;
  query.set("fixedDpr", "0.5");
  history.replaceState(null, "", "?" + query);
  const original = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    const light = { ...options, antialias: false, preserveDrawingBuffer: false };
    return original.call(this, kind, kind.startsWith("webgl") ? light : options);
  };
})();
