// Connection to the server.

import type { Replies, Requests } from "./wire.gen";

export interface Reply<F> {
  facts: F;
  body: ArrayBuffer;
  raw: ArrayBuffer;
}

/** Splits a message into its JSON and its body. */
export function parseMessage(message: ArrayBuffer): Reply<Record<string, unknown>> {
  const length = new DataView(message).getUint32(0, true);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(message, 4, length)));
  return { facts, body: message.slice(4 + length), raw: message };
}

interface Waiting {
  resolve(reply: Reply<Record<string, unknown>>): void;
  reject(error: Error): void;
  text: string;
}

/** A WebSocket that reconnects by itself and repeats unanswered requests. */
export class Connection {
  private socket: WebSocket | null = null;
  private waiting = new Map<number, Waiting>();
  private next = 1;
  private pause = 500;

  constructor(
    private readonly address: string,
    private readonly onState: (open: boolean) => void,
  ) {
    this.open();
  }

  ask<Op extends keyof Requests>(op: Op, body: Requests[Op]): Promise<Reply<Replies[Op]>> {
    const id = this.next++;
    const text = JSON.stringify({ id, op, ...body });
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve: (reply) => resolve(reply as Reply<unknown> as Reply<Replies[Op]>), reject, text });
      if (this.socket?.readyState === WebSocket.OPEN) {
        this.socket.send(text);
      }
    });
  }

  private open(): void {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.pause = 500;
      this.onState(true);
      for (const { text } of this.waiting.values()) {
        socket.send(text);
      }
    };
    socket.onmessage = ({ data }) => this.receive(data as ArrayBuffer);
    socket.onclose = () => {
      this.onState(false);
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, 5000);
    };
    this.socket = socket;
  }

  private receive(data: ArrayBuffer): void {
    const reply = parseMessage(data);
    const id = reply.facts["id"] as number;
    const waiting = this.waiting.get(id);
    if (!waiting) {
      return;
    }
    this.waiting.delete(id);
    const error = reply.facts["error"];
    if (typeof error === "string") {
      waiting.reject(new Error(error));
    } else {
      waiting.resolve(reply);
    }
  }
}
