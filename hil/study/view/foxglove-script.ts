import { Input } from "./types";

type Output = {
TYPES
};

export const inputs = ["TOPIC"];
export const output = "OUTPUT";

export default function script(event: Input<"TOPIC">): Output {
  const row = event.message;
  return {
VALUES
  };
}
