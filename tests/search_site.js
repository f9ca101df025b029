// Asks the search of a built site: node search_site.js FOLDER QUERY prints the addresses that it finds, the best first, as JSON.
// The site's own script is run, with the messages that its pages send.
"use strict"
const fs = require("fs")
const path = require("path")

const [site, query] = process.argv.slice(2)
const workers = path.join(site, "assets/javascripts/workers")
const script = fs.readdirSync(workers).find(name => /^search\..*\.js$/.test(name))
const index = JSON.parse(fs.readFileSync(path.join(site, "search/search_index.json"), "utf-8"))

const SETUP = 0, READY = 1, QUERY = 2, RESULT = 3

let answer
global.self = global
global.addEventListener = (_, handler) => { answer = handler }
global.postMessage = message => {
  if (message.type === READY) answer({ data: { type: QUERY, data: query } })
  if (message.type === RESULT) console.log(JSON.stringify(message.data.items.map(pages => pages[0].location)))
}
eval(fs.readFileSync(path.join(workers, script), "utf-8"))
answer({ data: { type: SETUP, data: { ...index, options: { suggest: false } } } })
