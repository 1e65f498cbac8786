// Prints where Chromium lies, and where its libraries do, as JSON; unpacks them first if need be.
process.env.AWS_EXECUTION_ENV = "AWS_Lambda_nodejs20.x"; // its libraries come out of the package too
const { default: chromium } = await import("@sparticuz/chromium");
const path = await chromium.executablePath();
console.log(JSON.stringify({ path, libraries: process.env.LD_LIBRARY_PATH ?? "", fonts: process.env.FONTCONFIG_PATH ?? "" }));
