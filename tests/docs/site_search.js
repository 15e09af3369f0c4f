// Asks the search of a built site, in its own worker: node site_search.js SITE < QUERIES (JSON list) > PAGES (JSON list).
"use strict";
const fs = require("fs");
const path = require("path");
const vm = require("vm");

const site = process.argv[2];
const workers = path.join(site, "assets/javascripts/workers");
const name = fs.readdirSync(workers).find((file) => /^search.*\.js$/.test(file));
const index = JSON.parse(fs.readFileSync(path.join(site, "search/search_index.json"), "utf8"));
const queries = JSON.parse(fs.readFileSync(0, "utf8"));

let listen = null;
const answers = [];
const scope = { console, addEventListener: (_, listener) => { listen = listener; }, postMessage: (answer) => answers.push(answer) };
scope.self = scope;
vm.createContext(scope);
vm.runInContext(fs.readFileSync(path.join(workers, name), "utf8"), scope);

async function ask(type, data) {
  listen({ data: { type, data } });
  while (!answers.length) await new Promise((resolve) => setTimeout(resolve, 5));
  return answers.shift().data;
}

(async () => {
  await ask(0, { ...index, options: { suggest: false } });
  const found = [];
  for (const query of queries) {
    const { items } = await ask(2, query);
    found.push(items.map((sections) => sections[0].location.split("#")[0]));
  }
  process.stdout.write(JSON.stringify(found));
})();
