/** `../../pages/x.js` of an application's module is a module of the room's pages. */
export async function resolve(specifier, context, next) {
  const shared = /^\.\.\/\.\.\/pages\/(.+)$/.exec(specifier);
  return next(shared ? new URL(`../../../synchronizar/live/pages/${shared[1]}`, import.meta.url).href : specifier, context);
}
