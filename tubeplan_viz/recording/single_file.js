"use strict";
// The page may be opened from disk, where nothing can be fetched: the viewer and the recording are text in it.
const state = document.getElementById("state");
async function unpacked(id) {
  const element = document.getElementById(id);
  const text = atob(element.textContent);
  element.remove();
  const packed = Uint8Array.from(text, (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
async function start() {
  await wasm_bindgen({ module_or_path: (await unpacked("wasm")).buffer });
  const renderer = new URLSearchParams(location.search).get("renderer");
  const handle = new wasm_bindgen.WebHandle({ hide_welcome_screen: true, enable_history: false, persist: false, notebook: false, render_backend: renderer });
  await handle.start(document.getElementById("viewer"));
  const name = "recording.rrd";
  handle.open_channel(name, name);
  handle.send_rrd_to_channel(name, await unpacked("rrd"));
  handle.close_channel(name);
  state.hidden = true;
  document.body.dataset.started = "";
  const watch = setInterval(() => {
    if (handle.has_panicked()) {
      clearInterval(watch);
      fail(handle.panic_message());
    }
  }, 1000);
}
function fail(fault) {
  state.hidden = false;
  state.textContent = `The viewer cannot run here (${fault}). It needs a browser of 2023 or later with WebGL 2; recording.rrd in the run folder opens in the rerun viewer as well.`;
}
start().catch(fail);
