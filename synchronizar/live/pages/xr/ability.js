/** Whether this browser can show AR, and if not, why, in a sentence with a way on. */

export async function canShowAr() {
  if (!globalThis.isSecureContext) {
    return no("AR needs https: open the address that begins with https://. You can look all the same.");
  }
  if (!navigator.xr) {
    return no("This browser has no AR: use Chrome on an Android phone, or a headset's own browser. You can look all the same.");
  }
  try {
    if (await navigator.xr.isSessionSupported("immersive-ar")) return { ar: true, why: "" };
  } catch {
    return no("AR is switched off for this page in the browser's settings. You can look all the same.");
  }
  return no("This device cannot show AR. You can look all the same.");
}

function no(why) {
  return { ar: false, why };
}
