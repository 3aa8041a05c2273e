// What the scripts of all pages share. Every text of the data reaches a page through textContent or
// setAttribute: names come from models, methods and files of unknown origin.
const data = JSON.parse(document.getElementById("data").textContent);
const $ = id => document.getElementById(id);
const make = (tag, options = {}, ...children) => {
  const node = document.createElement(tag);
  for (const [key, value] of Object.entries(options))
    key in node ? node[key] = value : node.setAttribute(key, value);
  node.append(...children);
  return node;
};
const draw = (tag, attributes = {}, text) => {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== undefined) node.textContent = text;
  return node;
};
const plural = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
