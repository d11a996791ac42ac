/* Order of search results: reference, guides and tutorials before benchmarks, which hold every word many times. */
var Scorer = {
  score: ([docname, title, anchor, description, score]) => {
    const late = /^(measured\/|made\/(measured|measuring|benchmarks|ablation|tried|changes|backend|contributing)|paper)/;
    if (late.test(docname)) return score - 40;
    if (/^(made\/api\/|made\/commands|parameters|reference\/)/.test(docname)) return score + 6;
    return score + 8;
  },
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
