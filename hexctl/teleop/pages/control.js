const PERIOD_MS = 40;                      // 25 messages a second while a finger or a key is down
const at = id => document.getElementById(id);
let socket = null, timer = null, opened = false, held = null;

function send(message) { if (socket && socket.readyState === 1) socket.send(JSON.stringify(message)); }
function hold(shares) {                    // what moves the robot, as long as it is repeated
  held = shares; send({ v: held });
  if (!timer) timer = setInterval(() => send({ v: held }), PERIOD_MS);
}
function release() { clearInterval(timer); timer = held = null; send({ release: true }); }
for (const kind of ["blur", "pagehide"]) window.addEventListener(kind, () => letGo());
document.addEventListener("visibilitychange", () => { if (document.hidden) letGo(); });
document.addEventListener("contextmenu", e => e.preventDefault());
function stop() { letGo(); send({ do: "stop" }); }
at("stop").addEventListener("pointerdown", stop);
at("stop").addEventListener("click", e => { if (e.detail === 0) stop(); });  // from a key, not from the finger above
for (const b of document.querySelectorAll("[data-do]")) b.addEventListener("click", () => send({ do: b.dataset.do }));

function plain(value, digits) { return value.toFixed(digits).replace(/^-(?=[0.]*$)/, ""); }  // no -0.000
function say(what, said) { at("what").textContent = what; at("said").textContent = said; at("said").classList.remove("stopped"); }
function opening(path, token) {
  return new WebSocket(location.origin.replace(/^http/, "ws") + path, ["hexctl.drive.1", ...(token ? ["token." + token] : [])]);
}
function connect() {
  const token = sessionStorage.getItem("token");
  opened = false;
  socket = opening("/drive", token);
  socket.onopen = () => { opened = true; release(); at("ask").classList.remove("open"); document.querySelector("main").classList.remove("off"); };
  socket.onmessage = e => show(JSON.parse(e.data));
  socket.onclose = () => {
    letGo();
    document.querySelector("main").classList.add("off");
    at("speed").textContent = at("power").textContent = "";
    say("not connected", "Nothing reaches the robot; trying again.");
    if (opened || location.protocol !== "https:") { setTimeout(connect, 1000); return; }
    // Refused or out of reach? The socket does not tell; the page itself needs no token.
    fetch("/", { cache: "no-store" }).then(() => {
      say("not connected", token ? "This is not the token that hexctl has printed." : "");
      at("ask").classList.add("open");
    }, () => setTimeout(connect, 1000));
  };
}
at("ask").addEventListener("submit", e => {
  e.preventDefault();
  sessionStorage.setItem("token", at("token").value.toLowerCase().replace(/[^a-z0-9]/g, ""));
  connect();
});
