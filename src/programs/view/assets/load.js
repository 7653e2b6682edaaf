// Fetching from the server of this page, with words for what goes wrong.

async function get(path) {
  let response;
  try {
    response = await fetch(path);
  } catch {
    throw new Error('unbake view has ended: start it again and reload this page.');
  }
  if (!response.ok) throw new Error((await response.text()).trim() || `${path}: ${response.status}`);
  return response;
}

export const json = async (path) => (await get(path)).json();
export const bytes = async (path) => (await get(path)).arrayBuffer();

// The largest texture side worth asking for: phones get 2048, others what the card can do up to 4096.
export function textureCap(gl, caps) {
  const small = Math.min(screen.width, screen.height) < 700 || matchMedia('(pointer: coarse)').matches;
  const memory = navigator.deviceMemory ?? 8;
  const wanted = memory <= 1 ? 1024 : small || memory <= 4 ? 2048 : 4096;
  const possible = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  return Math.max(...caps.filter((c) => c <= Math.min(wanted, possible)), caps[0]);
}
