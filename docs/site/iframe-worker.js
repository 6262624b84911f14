// The search of the theme runs in a worker. Browsers refuse workers to pages from a folder: there
// a hidden frame stands in, which answers by messages as a worker does.
if (location.protocol === "file:") {
  // The search asks for this name to know where it runs.
  window.Worker = window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.ready = new Promise((resolve) => {
        window.addEventListener("message", (event) => {
          if (event.source !== this.frame.contentWindow) return;
          if (event.data === "worker is ready") return resolve();
          const answer = new MessageEvent("message", { data: event.data });
          this.dispatchEvent(answer);
          if (this.onmessage) this.onmessage(answer);
        });
      });
      document.body.append(this.frame);
      const inside = this.frame.contentWindow.document;
      inside.open();
      inside.write(`<script>
        function postMessage(data) { parent.postMessage(data, "*"); }
        function importScripts(...urls) {
          return Promise.all(urls.map((url) => new Promise((resolve, reject) => {
            const script = document.createElement("script");
            script.src = url; script.onload = resolve; script.onerror = reject;
            document.head.append(script);
          })));
        }
      <\/script><script src="${url}"><\/script>
      <script>postMessage("worker is ready");<\/script>`);
      inside.close();
    }
    postMessage(data) {
      this.ready.then(() => this.frame.contentWindow.dispatchEvent(
        new MessageEvent("message", { data })));
    }
    terminate() { this.frame.remove(); }
  };
}
