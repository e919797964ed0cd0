// Pages whose pictures stand still: colours, and folds that open for print.
import './page.js';

document.documentElement.classList.add('script');
globalThis.tubeplanReady = true;
